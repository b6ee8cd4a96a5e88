"""Deletes a model permanently."""

from core.errors import ModelInUse
from core.jobs.store import JobStore
from core.storage import keys
from core.storage.objects import ObjectStore
from core.user_models import library


def remove_model(model_id: str, *, store: JobStore, objects: ObjectStore) -> None:
    """Remove its file and its record. Raises ModelNotFound, and ModelInUse while a job needs it.

    Ended jobs keep their files, but their policies cannot be run here any more.
    """
    library.find(model_id, store)
    if users := store.users_of(model_id):
        raise ModelInUse(model_id, users)
    objects.delete_prefix(keys.previews_of(model_id))
    library.forget(model_id, store=store, objects=objects)
