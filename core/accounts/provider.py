"""The answer of the lab's identity provider about a user, and the rights that follow from it."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from core.accounts.principal import NAME, Role
from core.errors import Conflict
from core.settings import ApiSettings, GroupGrant

EVERYBODY = "*"


class SignInRefused(Conflict):
    """The identity provider, or what it says of somebody, does not let them in; `detail` says why."""

    code = "sign-in-refused"
    title = "The sign-in is refused"


@dataclass(frozen=True)
class Grant:
    """A user to let in. subject: at the provider, with its issuer; it never changes.

    role, projects: of a new user. is_kept: also those of a user who is there already; `managed` are then the
    projects that the user leaves unless `projects` has them.
    """

    name: str
    subject: str
    role: Role
    projects: frozenset[str]
    is_kept: bool = False
    managed: frozenset[str] = frozenset()


@dataclass(frozen=True)
class ProviderRules:
    """Whom the provider's users become here.

    domains: of their addresses; EVERYBODY lets all in. trusts_emails: also those of which the provider does
    not say that it has checked them. groups: of which they need one, unless there are none here. role,
    projects: of a new user, beside those of groups.
    """

    user_claim: str
    groups_claim: str
    domains: frozenset[str]
    trusts_emails: bool
    groups: Mapping[str, GroupGrant]
    role: Role
    projects: frozenset[str]

    @classmethod
    def of(cls, settings: ApiSettings) -> "ProviderRules":
        """The rules that the settings make."""
        return cls(
            settings.oidc_user_claim,
            settings.oidc_groups_claim,
            domains=_listed(settings.oidc_domains.lower()),
            trusts_emails=settings.oidc_emails_are_verified,
            groups={name.removeprefix("/"): grant for name, grant in settings.oidc_groups.items()},
            role=Role(settings.oidc_role),
            projects=_listed(settings.oidc_projects),
        )

    def grant(self, claims: Mapping[str, Any]) -> Grant:
        """The rights that the claims of a checked ID token grant. Raises SignInRefused."""
        subject = f"{claims['iss']}#{claims['sub']}"
        self._check_domain(claims)
        name = self._name(claims)
        if not self.groups:
            return Grant(name, subject, self.role, self.projects)
        mine = [self.groups[group] for group in self._groups(claims) if group in self.groups]
        if not mine:
            raise SignInRefused(
                f"{name} is in none of the groups that may sign in ({', '.join(sorted(self.groups))}), says "
                f"the claim {self.groups_claim!r}."
            )
        return Grant(
            name,
            subject,
            role=max((Role(grant.role) for grant in mine), key=lambda role: role.rank),
            projects=self.projects.union(*(grant.projects for grant in mine)),
            is_kept=True,
            managed=frozenset[str]().union(*(grant.projects for grant in self.groups.values())),
        )

    def _check_domain(self, claims: Mapping[str, Any]) -> None:
        if not self.domains or EVERYBODY in self.domains:
            return
        address = claims.get("email")
        # Google says the domain of a company's accounts apart; a private account may have such an address.
        domain = claims.get("hd") or (address.rpartition("@")[2] if isinstance(address, str) else None)
        if not self._is_verified(claims) or not isinstance(domain, str):
            raise SignInRefused(
                "The provider does not say a checked address, whose domain decides who may sign in: see "
                "GAITWAY_OIDC_EMAILS_ARE_VERIFIED."
            )
        if domain.lower() not in self.domains:
            raise SignInRefused(f"Accounts of {domain[:100]} may not sign in here.")

    def _is_verified(self, claims: Mapping[str, Any]) -> bool:
        return claims.get("email_verified", self.trusts_emails) in (True, "true")

    def _name(self, claims: Mapping[str, Any]) -> str:
        said = claims.get(self.user_claim)
        if not isinstance(said, str) or not said:
            raise SignInRefused(
                f"The provider does not say the claim {self.user_claim!r}, which names the user: see "
                "GAITWAY_OIDC_USER_CLAIM and GAITWAY_OIDC_SCOPES."
            )
        if self.user_claim == "email" and not self._is_verified(claims):
            raise SignInRefused(
                f"The provider does not say that it has checked the address {said[:100]}: see "
                "GAITWAY_OIDC_EMAILS_ARE_VERIFIED."
            )
        name = said.lower()
        if re.fullmatch(NAME, name) is None:
            raise SignInRefused(
                f"{said[:100]!r} cannot be a user's name (small letters, digits and ._@-, 63 at most): see "
                "GAITWAY_OIDC_USER_CLAIM."
            )
        return name

    def _groups(self, claims: Mapping[str, Any]) -> list[str]:
        """Keycloak writes a group as a path."""
        said = claims.get(self.groups_claim)
        groups = cast("list[Any]", said) if isinstance(said, list) else [said]
        return [group.removeprefix("/") for group in groups if isinstance(group, str)]


def _listed(text: str) -> frozenset[str]:
    return frozenset(part.strip() for part in text.split(",")) - {""}
