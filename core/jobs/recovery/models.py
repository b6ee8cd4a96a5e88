"""Users' own models on which the record and the bucket disagree."""

from collections.abc import Iterator
from functools import partial

from core.errors import ModelNotFound
from core.jobs.orphans import folders
from core.jobs.recovery.finding import Finding, sizes_of
from core.jobs.store import JobStore
from core.storage import keys
from core.storage.objects import ObjectStore
from core.user_models.record import ModelRecord


def models(store: JobStore, objects: ObjectStore) -> Iterator[Finding]:
    known = {record.id for record in store.models() if record.status != "refused"}
    for name, infos in folders(objects.list(keys.models())):
        model_id = f"sha256:{name}"
        if keys.model_source(model_id) not in sizes_of(infos):
            continue
        known.discard(model_id)
        if not _is_known(model_id, store):
            sentence = f"Model {model_id}: not in the record. A worker has to validate it again."
            yield Finding(sentence, "adopt", partial(_adopt_model, model_id, store, objects))
    for model_id in sorted(known):
        if _is_known(model_id, store):  # And was not deleted meanwhile.
            sentence = f"Model {model_id}: the bucket has lost its file. It has to be sent again."
            yield Finding(sentence, "mark", partial(store.delete_model, model_id))


def _is_known(model_id: str, store: JobStore) -> bool:
    try:
        store.find_model(model_id)
    except ModelNotFound:
        return False
    return True


def _adopt_model(model_id: str, store: JobStore, objects: ObjectStore) -> None:
    source = objects.info(keys.model_source(model_id))
    store.add_model(
        ModelRecord(
            id=model_id,
            status="validating",
            media_type=source.media_type,
            size=source.size,
            created_at=source.modified_at or store.now(),
        )
    )
