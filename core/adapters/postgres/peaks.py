"""What trainings took of a GPU's memory, by what they have in common (`core.jobs.sharing`)."""

from sqlalchemy import Connection, delete, func, text
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres.engine import Session
from core.adapters.postgres.tables import NOW, peaks

# So long after the last such training, the next one is measured again.
_FORGOTTEN = text("interval '90 days'")


class PeakQueries(Session):
    """The part of a JobStore that remembers what was measured."""

    def keep_peak(self, alike: str, num_bytes: int) -> None:
        write = insert(peaks).values(alike=alike, bytes=num_bytes, measured_at=NOW)
        largest = func.greatest(peaks.c.bytes, write.excluded.bytes)
        written = {"bytes": largest, "measured_at": NOW}
        with self._statements() as connection:
            connection.execute(write.on_conflict_do_update(index_elements=["alike"], set_=written))

    def forget_peak(self, alike: str) -> None:
        with self._statements() as connection:
            connection.execute(delete(peaks).where(peaks.c.alike == alike))


def forget_old_peaks(connection: Connection) -> None:
    connection.execute(delete(peaks).where(peaks.c.measured_at < NOW - _FORGOTTEN))
