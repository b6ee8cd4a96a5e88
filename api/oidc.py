"""Signing in at the lab's identity provider: OpenID Connect, the authorization code flow with PKCE.

Source: OpenID Connect Core 1.0, section 3.1; RFC 7636 (PKCE); RFC 9207 (`iss` in the answer).
Authlib and httpx are loaded where they are used: a service without a provider saves 8 MB in each process.
"""

import base64
import hmac
import json
import secrets
import time
from collections.abc import Mapping
from threading import Lock
from typing import TYPE_CHECKING, Annotated, Any, cast
from urllib.parse import quote, urlencode, urlsplit

import structlog
from pydantic import Field, ValidationError

from core.accounts.provider import SignInRefused
from core.documents import Strict
from core.errors import Unavailable
from core.settings import ApiSettings, is_safe_address

if TYPE_CHECKING:
    from joserfc.jwk import KeySet

log = structlog.get_logger()
# Signatures by the provider's private key: neither `none`, nor HMACs, whose key we would share.
_ALGORITHMS = frozenset(
    {"RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "EdDSA"}
)
_KEY_TYPES = frozenset({"RSA", "EC", "OKP"})
# Clocks may differ by this.
_SKEW_S = 60
_TIMEOUT_S = 5.0
_DEADLINE_S = 10.0
_MOST_BYTES = 2**18
_CACHED_S = 3600.0
_AWAY_CACHED_S = 5.0
# Keys are asked for again where a token names one that is not among them.
_KEYS_AGAIN_S = 60.0


class ProviderAway(Unavailable):
    """The identity provider does not answer, or not as one."""

    code = "provider-away"
    title = "The identity provider does not answer"


# Where the page was: its own fragment, so that nobody can have the sign-in end elsewhere.
PagePlace = Annotated[str, Field(max_length=2000, pattern=r"^(#/[ -~]*)?$")]


class Attempt(Strict):
    """A sign-in that has begun. The browser that began it keeps this in a cookie, and no other has it.

    back: where the page was. Nothing signs the cookie, so that all of it is checked again.
    """

    state: str
    nonce: str
    verifier: str
    redirect_uri: str
    back: PagePlace

    @property
    def text(self) -> str:
        """It as a cookie's value."""
        return base64.urlsafe_b64encode(self.model_dump_json().encode()).decode().rstrip("=")

    @classmethod
    def read(cls, text: str) -> "Attempt | None":
        """The attempt in a cookie; None if it has none."""
        try:
            return cls.model_validate_json(base64.urlsafe_b64decode(text + "=" * (-len(text) % 4)))
        except (ValueError, ValidationError):
            return None


class IdentityProvider:
    """The provider that the settings name; thread-safe. What it says of itself is kept for an hour."""

    def __init__(self, settings: ApiSettings) -> None:
        assert settings.oidc_issuer is not None  # noqa: S101
        assert settings.oidc_client_id is not None  # noqa: S101
        self.name = settings.oidc_name
        self._issuer = settings.oidc_issuer
        self._client_id = settings.oidc_client_id
        secret = settings.oidc_client_secret
        self._secret = None if secret is None else secret.get_secret_value()
        self._scopes = settings.oidc_scopes
        self._lock = Lock()
        self._kept: dict[str, tuple[float, dict[str, Any]]] = {}
        self._away: tuple[float, ProviderAway | None] = (0.0, None)

    def begin(self, redirect_uri: str, back: str) -> tuple[Attempt, str]:
        """An attempt, and the address at the provider to send the browser to. Raises ProviderAway."""
        from authlib.oauth2 import rfc7636

        endpoint = self._endpoint("authorization_endpoint")
        attempt = Attempt(
            state=secrets.token_urlsafe(32),
            nonce=secrets.token_urlsafe(32),
            verifier=secrets.token_urlsafe(48),
            redirect_uri=redirect_uri,
            back=back,
        )
        challenge: Any = rfc7636.create_s256_code_challenge  # pyright: ignore
        query = urlencode(
            {
                "response_type": "code",
                "client_id": self._client_id,
                "redirect_uri": redirect_uri,
                "scope": self._scopes,
                "state": attempt.state,
                "nonce": attempt.nonce,
                "code_challenge": str(challenge(attempt.verifier)),
                "code_challenge_method": "S256",
            }
        )
        return attempt, f"{endpoint}{'&' if '?' in endpoint else '?'}{query}"

    def finish(self, attempt: Attempt | None, answer: Mapping[str, str]) -> dict[str, Any]:
        """The claims of whom the provider sent back with this query. Raises SignInRefused, ProviderAway."""
        state = answer.get("state", "")
        if attempt is None or not hmac.compare_digest(state.encode(), attempt.state.encode()):
            raise SignInRefused(
                "This browser has not begun this sign-in, or more than ten minutes ago, or another since: "
                "begin again."
            )
        if "error" in answer:
            said = _readable(f"{answer['error']}: {answer.get('error_description', '')}".rstrip(": "))
            raise SignInRefused(f"The identity provider refuses: {said}.")
        if answer.get("iss", self._issuer) != self._issuer or not answer.get("code"):
            raise SignInRefused("This is no answer of the identity provider.")
        token = self._exchange(attempt, answer["code"])
        return self._claims(token, attempt)

    def _exchange(self, attempt: Attempt, code: str) -> dict[str, Any]:
        form = {
            "grant_type": "authorization_code",
            "code": code,
            "redirect_uri": attempt.redirect_uri,
            "code_verifier": attempt.verifier,
        }
        basic = None
        ways = self._metadata().get("token_endpoint_auth_methods_supported", ["client_secret_basic"])
        if self._secret is not None and "client_secret_basic" in ways:
            basic = (quote(self._client_id, safe=""), quote(self._secret, safe=""))  # RFC 6749, section 2.3.1
        else:
            form["client_id"] = self._client_id
            if self._secret is not None:
                form["client_secret"] = self._secret
        status, document = self._ask("POST", self._endpoint("token_endpoint"), form, basic)
        if status >= 500:
            raise ProviderAway(f"The identity provider answers with status {status}.")
        if status != 200:
            said = _readable(
                f"{document.get('error', status)}: {document.get('error_description', '')}".rstrip(": ")
            )
            raise SignInRefused(f"The identity provider does not accept this sign-in: {said}.")
        return document

    def _claims(self, token: Mapping[str, Any], attempt: Attempt) -> dict[str, Any]:
        """The ID token's claims. Raises SignInRefused unless it is signed, for us, and of this attempt."""
        from authlib.oidc.core import CodeIDToken
        from joserfc import jwt
        from joserfc.errors import JoseError

        text = token.get("id_token")
        if not isinstance(text, str):
            raise SignInRefused("The identity provider sent no ID token: GAITWAY_OIDC_SCOPES needs `openid`.")
        said = self._metadata().get("id_token_signing_alg_values_supported", ["RS256"])
        algorithms = sorted(_ALGORITHMS.intersection(said))
        issuer = self._metadata()["issuer"]
        try:
            try:
                decoded = jwt.decode(text, self._keys(), algorithms=algorithms)
            except JoseError:
                if not self._may_ask_for_keys_again():
                    raise
                decoded = jwt.decode(text, self._keys(), algorithms=algorithms)
            claims = CodeIDToken(
                decoded.claims,
                decoded.header,
                {
                    "iss": {"essential": True, "value": issuer},
                    "aud": {"essential": True, "value": self._client_id},
                    "sub": {"essential": True},
                    "nonce": {"essential": True, "value": attempt.nonce},
                },
                {
                    "nonce": attempt.nonce,
                    "client_id": self._client_id,
                    "access_token": token.get("access_token"),
                },
            )
            claims.validate(leeway=_SKEW_S)  # pyright: ignore[reportUnknownMemberType]
        except (JoseError, ValueError, TypeError) as error:
            log.warning("id_token_refused", error=repr(error))
            raise SignInRefused(
                f"The identity provider's token is not valid: {_readable(str(error)) or repr(error)}."
            ) from None
        if not isinstance(claims["sub"], str):
            raise SignInRefused("The identity provider's token has no subject.")
        return dict(claims)

    def _keys(self) -> "KeySet":
        from joserfc.jwk import KeySet

        document = self._kept_document("keys", self._endpoint("jwks_uri"))
        keys = cast("list[Any]", document.get("keys", []))
        usable = [key for key in keys if key.get("kty") in _KEY_TYPES and key.get("use", "sig") == "sig"]
        return KeySet.import_key_set({"keys": usable})

    def _may_ask_for_keys_again(self) -> bool:
        """Whether the next look at the keys asks for them: the provider may have new ones."""
        until, _ = self._kept["keys"]
        if until - _CACHED_S + _KEYS_AGAIN_S > time.monotonic():
            return False
        del self._kept["keys"]
        return True

    def _endpoint(self, name: str) -> str:
        address = self._metadata().get(name)
        if not isinstance(address, str) or not is_safe_address(address):
            raise ProviderAway(f"The identity provider says no safe address (https) as its {name}.")
        return address

    def _metadata(self) -> dict[str, Any]:
        address = f"{self._issuer.rstrip('/')}/.well-known/openid-configuration"
        document = self._kept_document("metadata", address)
        if document.get("issuer") != self._issuer:
            raise ProviderAway(
                f"What answers at {self._issuer} calls itself {_readable(str(document.get('issuer')))}: "
                "write exactly that as GAITWAY_OIDC_ISSUER."
            )
        return document

    def _kept_document(self, name: str, address: str) -> dict[str, Any]:
        with self._lock:  # One asks, and others wait for the answer.
            until, document = self._kept.get(name, (0.0, {}))
            if time.monotonic() < until:
                return document
            away_until, away = self._away
            if away is not None and time.monotonic() < away_until:
                raise away
            try:
                status, document = self._ask("GET", address)
                if status != 200:
                    raise ProviderAway(f"The identity provider answers {address} with status {status}.")
            except ProviderAway as error:
                self._away = (time.monotonic() + _AWAY_CACHED_S, error)
                raise
            self._kept[name] = (time.monotonic() + _CACHED_S, document)
            return document

    def _ask(
        self,
        method: str,
        address: str,
        form: Mapping[str, str] | None = None,
        basic: tuple[str, str] | None = None,
    ) -> tuple[int, dict[str, Any]]:
        """Status and JSON object of an answer. Raises ProviderAway for none in time, or another kind."""
        import httpx

        until = time.monotonic() + _DEADLINE_S
        body = bytearray()
        try:
            with (
                httpx.Client(timeout=_TIMEOUT_S) as client,
                client.stream(
                    method, address, data=form, auth=basic, headers={"Accept": "application/json"}
                ) as answer,
            ):
                for piece in answer.iter_bytes():
                    body += piece
                    if len(body) > _MOST_BYTES or time.monotonic() > until:
                        raise ProviderAway("The identity provider's answer is too long, or takes too long.")
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            host = urlsplit(address).netloc
            raise ProviderAway(
                f"The identity provider at {host} does not answer ({type(error).__name__})."
            ) from None
        try:
            document = json.loads(body)
        except ValueError:
            document = None
        if not isinstance(document, dict):
            if answer.status_code >= 400:
                return answer.status_code, {}
            raise ProviderAway(f"What answers at {urlsplit(address).netloc} is no identity provider.")
        return answer.status_code, cast("dict[str, Any]", document)


def _readable(text: str) -> str:
    return "".join(letter for letter in text if letter.isprintable())[:200].rstrip(".")
