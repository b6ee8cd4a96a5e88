"""Webhooks, news and deliveries.

News is written with the change of a job (`saving`). A sender's two steps are one transaction each: it makes
deliveries of news, and it claims those that are due. A claim only sets the time of the next try: that of a
sender that dies runs out, and then another one sends again.
"""

from collections.abc import Collection, Sequence
from typing import Any

from pydantic import SecretStr
from sqlalchemy import (
    Connection,
    Row,
    and_,
    bindparam,
    delete,
    exists,
    func,
    not_,
    or_,
    select,
    true,
    tuple_,
    update,
)
from sqlalchemy.dialects.postgresql import insert

from core.accounts.principal import Role
from core.accounts.store import Actor
from core.adapters.postgres.accounts import checked_cursor, note_audit, require_project
from core.adapters.postgres.engine import Session
from core.adapters.postgres.rows import Values, columns, interval, words
from core.adapters.postgres.tables import NOW, deliveries, members, news, projects, users, webhooks
from core.errors import DeliveryNotFound, TooManyWebhooks, WebhookExists, WebhookNotFound, WebhookUnsigned
from core.news.store import DeliveryPage
from core.news.webhook import (
    CLAIM,
    KEPT,
    MAX_WEBHOOKS,
    OVERLAP,
    Change,
    Delivery,
    Due,
    News,
    Outcome,
    Webhook,
    most_at_once,
    pause_after,
    shown_url,
    wants,
)

_PLACE = and_(deliveries.c.project == webhooks.c.project, deliveries.c.webhook == webhooks.c.name)
_COPIED = ("project", "webhook", "message", "event", "job", "document")
_SHOWN = [column for column in deliveries.c if column.name not in ("document", "project")]
# `NOW` changes within a statement, and so cannot bound the scan of an index.
_IS_DUE = and_(deliveries.c.status == "waiting", deliveries.c.next_attempt_at <= func.statement_timestamp())
_TELLS = or_(
    webhooks.c.owner.is_(None),
    exists().where(
        users.c.name == webhooks.c.owner,
        users.c.active,
        or_(
            users.c.role == Role.ADMIN.value,
            exists().where(members.c.user_name == users.c.name, members.c.project == webhooks.c.project),
        ),
    ),
)

_ADD = insert(news).values({**{column.name: bindparam(column.name) for column in news.c}, "created_at": NOW})


class NewsQueries(Session):
    """The part of a JobStore that has webhooks and what they are told."""

    def add_webhook(self, webhook: Webhook, actor: Actor) -> Webhook:
        values = webhook.model_dump(exclude={"url", "secret", "old_secret"})
        values["url"] = webhook.url.get_secret_value()
        values["secret"] = None if webhook.secret is None else webhook.secret.get_secret_value()
        new = insert(webhooks).values(values).on_conflict_do_nothing(index_elements=["project", "name"])
        its = webhooks.c.project == webhook.project
        with self._transaction() as connection:
            require_project(connection, webhook.project)
            # Two that are added at once come one after the other.
            connection.execute(
                select(projects.c.name).where(projects.c.name == webhook.project).with_for_update()
            )
            number = connection.execute(select(func.count()).select_from(webhooks).where(its)).scalar_one()
            if number >= MAX_WEBHOOKS:
                raise TooManyWebhooks(webhook.project, MAX_WEBHOOKS)
            if connection.execute(new.returning(webhooks.c.name)).first() is None:
                raise WebhookExists(webhook.project, webhook.name)
            note_audit(
                connection,
                actor,
                "webhook.added",
                f"project {webhook.project}",
                webhook=webhook.name,
                events=webhook.events,
                jobs=webhook.jobs,
            )
        return webhook

    def webhooks(self, project: str) -> Sequence[Webhook]:
        wanted = select(webhooks).where(webhooks.c.project == project).order_by(webhooks.c.name)
        with self._statements() as connection:
            require_project(connection, project)
            return [_webhook(row) for row in connection.execute(wanted)]

    def webhook(self, project: str, name: str) -> Webhook:
        with self._statements() as connection:
            return _find(connection, project, name)

    def change_webhook(self, project: str, name: str, change: Change, actor: Actor) -> Webhook:
        noted = values = change.model_dump(exclude_none=True, exclude={"url", "active"})
        if change.url is not None:
            url = change.url.get_secret_value()
            values, noted = {**values, "url": url}, {**noted, "url": shown_url(url)}
        if change.active is not None:
            noted = {**noted, "active": change.active}
        if change.active:
            values = {**values, "stopped": None}
        with self._transaction() as connection:
            if values:
                connection.execute(update(webhooks).where(_is(project, name)).values(values))
            if change.active is False:
                _stop(connection, project, name, f"Stopped by {actor.user or 'hand'}.")
            if noted:
                note_audit(connection, actor, "webhook.changed", f"project {project}", webhook=name, **noted)
            return _find(connection, project, name)

    def rotate_secret(self, project: str, name: str, secret: SecretStr, actor: Actor) -> Webhook:
        values = {
            "old_secret": webhooks.c.secret,
            "old_secret_until": NOW + interval(OVERLAP),
            "secret": secret.get_secret_value(),
        }
        has_one = and_(_is(project, name), webhooks.c.secret.is_not(None))
        with self._transaction() as connection:
            if connection.execute(update(webhooks).where(has_one).values(values)).rowcount == 0:
                raise WebhookUnsigned(_find(connection, project, name).name)
            note_audit(connection, actor, "webhook.rotated", f"project {project}", webhook=name)
            return _find(connection, project, name)

    def remove_webhook(self, project: str, name: str, actor: Actor) -> None:
        gone = delete(webhooks).where(_is(project, name)).returning(webhooks.c.name)
        with self._transaction() as connection:
            if connection.execute(gone).first() is None:
                raise WebhookNotFound(project, name)
            note_audit(connection, actor, "webhook.deleted", f"project {project}", webhook=name)

    def add_test(self, project: str, name: str, news: News) -> Delivery:
        with self._transaction() as connection:
            webhook = _find(connection, project, name)
            values = {**_delivery_values(webhook, news), "created_at": NOW, "next_attempt_at": NOW}
            added = insert(deliveries).values(values)
            return _delivery(connection.execute(added.returning(*_SHOWN)).one())

    def webhook_of(self, delivery: int) -> Webhook:
        its = select(webhooks).join(deliveries, _PLACE).where(deliveries.c.id == delivery)
        with self._statements() as connection:
            row = connection.execute(its).first()
        if row is None:
            raise DeliveryNotFound(delivery)
        return _webhook(row)

    def resend(self, delivery: int) -> Delivery:
        # A removal of the webhook waits for the new one, and removes it, too.
        known = select(deliveries).join(webhooks, _PLACE).where(deliveries.c.id == delivery)
        known = known.with_for_update(read=True, key_share=True, of=webhooks)
        with self._transaction() as connection:
            row = connection.execute(known).first()
            if row is None:
                raise DeliveryNotFound(delivery)
            copied = {column: getattr(row, column) for column in _COPIED}
            added = insert(deliveries).values({**copied, "created_at": NOW, "next_attempt_at": NOW})
            new = _delivery(connection.execute(added.returning(*_SHOWN)).one())
            _end_waiting(
                connection, deliveries.c.id == delivery, f"Sent again by hand, as delivery {new.id}."
            )
        return new

    def deliveries(
        self,
        *,
        project: str | None = None,
        webhook: str | None = None,
        job: str | None = None,
        cursor: str | None = None,
        limit: int = 50,
    ) -> DeliveryPage:
        wanted = select(*_SHOWN).order_by(deliveries.c.id.desc()).limit(limit + 1)
        for column, value in (("project", project), ("webhook", webhook), ("job", job)):
            if value is not None:
                wanted = wanted.where(deliveries.c[column] == value)
        if cursor is not None:
            wanted = wanted.where(deliveries.c.id < checked_cursor(cursor))
        with self._statements() as connection:
            found = [_delivery(row) for row in connection.execute(wanted)]
        return DeliveryPage(found[:limit], str(found[limit - 1].id) if len(found) > limit else None)

    def spread_news(self, limit: int = 200) -> int:
        oldest = select(news).order_by(news.c.created_at).limit(limit).with_for_update(skip_locked=True)
        with self._transaction() as connection:
            found = connection.execute(oldest).all()
            if not found:
                return 0
            known = select(webhooks).where(webhooks.c.project.in_({row.project for row in found}), _TELLS)
            # A removal or a stop waits until these deliveries are there, and ends them, too.
            known = known.with_for_update(read=True)
            listeners = [_webhook(row) for row in connection.execute(known)]
            new = [
                {**_delivery_values(webhook, message), "created_at": row.created_at}
                for row in found
                for message in (News.model_validate(columns(row)),)
                for webhook in listeners
                if webhook.project == message.project and wants(webhook, message)
            ]
            if new:
                connection.execute(insert(deliveries).values(next_attempt_at=NOW), new)
            connection.execute(delete(news).where(news.c.id.in_([row.id for row in found])))
        return len(found)

    def claim_deliveries(
        self, limit: int, *, is_http: bool, but_not: Collection[tuple[str, str]] = ()
    ) -> Sequence[Due]:
        of_one = select(deliveries.c.id, deliveries.c.next_attempt_at).where(_PLACE, _IS_DUE)
        of_one = (
            of_one.order_by(deliveries.c.next_attempt_at)
            .limit(most_at_once(is_http=is_http))
            .lateral("of_one")
        )
        due = select(of_one.c.id).select_from(webhooks.join(of_one, true()))
        due = due.where(webhooks.c.secret.is_not(None) == is_http).order_by(of_one.c.next_attempt_at)
        if but_not:
            due = due.where(not_(tuple_(webhooks.c.project, webhooks.c.name).in_([*but_not])))
        # A sender that waits for the lock finds that the row is no longer due, and leaves it out.
        locked = select(deliveries.c.id).where(deliveries.c.id.in_(due.limit(limit)), _IS_DUE)
        claimed = (
            update(deliveries)
            .where(deliveries.c.id.in_(locked.with_for_update(skip_locked=True)), _PLACE)
            .values(next_attempt_at=NOW + CLAIM, attempts=deliveries.c.attempts + 1)
            .returning(
                deliveries.c.id.label("delivery"),
                deliveries.c.attempts,
                deliveries.c.message,
                deliveries.c.document,
                *webhooks.c,
            )
        )
        with self._transaction() as connection:
            return [_due(row) for row in connection.execute(claimed)]

    def note_outcome(self, due: Due, outcome: Outcome) -> None:
        is_over = outcome.error is None or outcome.is_final
        pause = None if is_over else pause_after(due.attempt, outcome.wait)
        values: dict[str, Any] = {"answer": outcome.answer, "error": words(outcome.error)}
        if pause is not None:
            values["next_attempt_at"] = NOW + interval(pause)
        else:
            status = "delivered" if outcome.error is None else "failed"
            values |= {"status": status, "next_attempt_at": None, "ended_at": NOW}
        its = and_(deliveries.c.id == due.id, deliveries.c.attempts == due.attempt)
        # Another address than the one that was asked goes on.
        asked = select(webhooks.c.name).where(webhooks.c.url == due.webhook.url.get_secret_value())
        asked = asked.where(_is(due.webhook.project, due.webhook.name)).with_for_update()
        with self._transaction() as connection:
            # The webhook before its deliveries, as in changes of it: so no two wait for each other.
            stops = outcome.stops and connection.execute(asked).first() is not None
            connection.execute(update(deliveries).where(its, deliveries.c.status == "waiting").values(values))
            if stops:
                _stop(connection, due.webhook.project, due.webhook.name, outcome.error)


def add(connection: Connection, message: News | None) -> None:
    for values in values_of(message):
        connection.execute(_ADD, values)


def values_of(message: News | None) -> Sequence[Values]:
    """The row of a message, without its time; none without one."""
    if message is None:
        return []
    return [{**message.model_dump(exclude={"notify"}), "notify": [*message.notify]}]


def forget_old(connection: Connection, limit: int = 5000) -> bool:
    """Remove deliveries that ended long ago, at most so many; whether there may be more."""
    old = select(deliveries.c.id).where(deliveries.c.ended_at < func.statement_timestamp() - KEPT)
    gone = connection.execute(delete(deliveries).where(deliveries.c.id.in_(old.limit(limit))))
    return gone.rowcount == limit


def forget_old_secrets(connection: Connection) -> None:
    """Remove secrets that sign no more."""
    old = update(webhooks).where(webhooks.c.old_secret_until <= NOW)
    connection.execute(old.values(old_secret=None, old_secret_until=None))


def _stop(connection: Connection, project: str, name: str, why: str | None) -> None:
    """Tell this webhook nothing more, and end what waits for it."""
    connection.execute(update(webhooks).where(_is(project, name)).values(stopped=words(why)))
    _end_waiting(connection, and_(deliveries.c.project == project, deliveries.c.webhook == name), why)


def _end_waiting(connection: Connection, which: Any, why: str | None) -> None:
    ended = {"status": "failed", "next_attempt_at": None, "ended_at": NOW, "error": words(why)}
    connection.execute(update(deliveries).where(which, deliveries.c.status == "waiting").values(ended))


def _delivery_values(webhook: Webhook, message: News) -> dict[str, Any]:
    return {
        "project": webhook.project,
        "webhook": webhook.name,
        "message": message.id,
        "event": message.event,
        "job": message.job,
        "document": message.document,
    }


def _is(project: str, name: str) -> Any:
    return and_(webhooks.c.project == project, webhooks.c.name == name)


def _find(connection: Connection, project: str, name: str) -> Webhook:
    row = connection.execute(select(webhooks).where(_is(project, name))).first()
    if row is None:
        raise WebhookNotFound(project[:64], name[:64])
    return _webhook(row)


def _webhook(row: Row[Any]) -> Webhook:
    return Webhook.model_validate(columns(row))


def _delivery(row: Row[Any]) -> Delivery:
    return Delivery.model_validate(columns(row))


def _due(row: Row[Any]) -> Due:
    return Due(
        id=row.delivery,
        attempt=row.attempts,
        message=row.message,
        document=row.document,
        webhook=_webhook(row),
    )
