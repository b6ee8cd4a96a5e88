"""The record in PostgreSQL."""

from datetime import datetime, timedelta

from sqlalchemy import Engine, delete, select

from core.adapters.postgres.accounts import AccountQueries
from core.adapters.postgres.engine import Clock
from core.adapters.postgres.feeds import FeedQueries
from core.adapters.postgres.jobs import JobQueries
from core.adapters.postgres.leases import LeaseQueries
from core.adapters.postgres.news import NewsQueries, forget_old, forget_old_secrets
from core.adapters.postgres.peaks import PeakQueries, forget_old_peaks
from core.adapters.postgres.preemption import PreemptionQueries
from core.adapters.postgres.quotas import QuotaQueries
from core.adapters.postgres.retention import RetentionQueries
from core.adapters.postgres.sweeps import SweepQueries
from core.adapters.postgres.tables import NOW, idempotency_keys, pulse, workers
from core.adapters.postgres.turns import TurnQueries
from core.adapters.postgres.uploads import UploadQueries
from core.adapters.postgres.usage import UsageQueries, fold
from core.adapters.postgres.workers import WorkerQueries
from core.adapters.timing import Observe, unobserved
from core.clips.record import CLIPS
from core.user_models.record import MODELS

_SELECT_NOW = select(NOW)


class PostgresJobStore(
    JobQueries,
    LeaseQueries,
    FeedQueries,
    NewsQueries,
    PeakQueries,
    PreemptionQueries,
    QuotaQueries,
    RetentionQueries,
    SweepQueries,
    TurnQueries,
    UsageQueries,
    WorkerQueries,
    AccountQueries,
):
    """A SweepStore, and so a JobStore, and an AccountStore, for many processes; thread-safe.

    Each method is one transaction, or a few statements that are one each; the interfaces state its promises.
    clock_age: how long `now` extrapolates from the database's last answer. observe: told of each call.
    """

    def __init__(
        self,
        engine: Engine,
        *,
        clock_age: timedelta = timedelta(seconds=1),
        observe: Observe = unobserved,
    ) -> None:
        super().__init__(engine, observe)
        self._clock = Clock(self._time, clock_age)
        self.models = UploadQueries(MODELS, engine, observe, self._breaker)
        self.clips = UploadQueries(CLIPS, engine, observe, self._breaker)

    def now(self) -> datetime:
        return self._clock.now()

    def tidy(self) -> None:
        with self._transaction() as connection:
            connection.execute(delete(idempotency_keys).where(idempotency_keys.c.forgotten_at <= NOW))
            connection.execute(delete(workers).where(workers.c.gone_at <= NOW))
            fold(connection)
            forget_old_peaks(connection)
            forget_old_secrets(connection)
        # A transaction each: there may be more than one statement has time for.
        is_more = True
        while is_more:
            with self._transaction() as connection:
                is_more = forget_old(connection)

    def ping(self) -> None:
        with self._statements() as connection:
            connection.execute(select(pulse.c.id))

    def _time(self) -> datetime:
        with self._statements() as connection:
            return connection.execute(_SELECT_NOW).scalar_one()
