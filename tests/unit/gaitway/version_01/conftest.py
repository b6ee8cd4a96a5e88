"""Version 0.1's data on the test's servers."""

import pytest
import redis

from core.adapters.s3.objects import S3ObjectStore
from core.settings import WorkerSettings
from tests.unit.gaitway.version_01.old import Old


@pytest.fixture
def old(settings: WorkerSettings, redis_client: redis.Redis, object_store: S3ObjectStore) -> Old:
    return Old(settings, redis_client, object_store)
