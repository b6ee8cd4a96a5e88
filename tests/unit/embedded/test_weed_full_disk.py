"""The object store after its disk was full: on a small disk in memory that one process alone sees."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

FULL_DISK = """
import json, sys
from pathlib import Path

from tests.faults.campaign.disks import Disk, take_own_mounts

if not take_own_mounts():
    sys.exit("This user may mount no disk.")

from core.adapters.s3.connection import connect_s3
from core.adapters.s3.objects import S3ObjectStore
from core.errors import StorageUnavailable
from gaitway.service.embedded.weed import Weed
from gaitway.service.embedded.weed import REGION


def keeps(store, key, body):
    try:
        store.put(key, body)
    except StorageUnavailable:
        return False
    return True


folder = Path(sys.argv[1])
disk = Disk(folder, 512)
with Weed(folder) as weed:
    keys = weed.access_key, weed.secret_key
    client = connect_s3(weed.endpoint, *keys, secure=False, region=REGION, retries=0)
    store = S3ObjectStore(client, weed.bucket)
    store.put("kept/first", b"first")
    disk.fill()
    kept = 1
    # What is empty needs no more than a name: the index fills its last page with them.
    while keeps(store, f"kept/{kept}", b""):
        kept += 1
    while_full = weed.needs_restart()
    disk.free()
    found = {
        "while full": while_full,
        "writes by itself": keeps(store, "kept/last", b"last"),
        "with room": weed.needs_restart(),
    }
    weed.process.stop(grace_s=0)
    weed.launch().wait_ready()
    found |= {
        "started again": weed.needs_restart(),
        "writes then": keeps(store, "kept/last", b"last"),
        "lost": kept + 1 - len(list(store.list("kept/"))),
        "first": store.get("kept/first").decode(),
    }
    weed.process.stop(grace_s=0)
print(json.dumps(found))
"""


def test_a_store_whose_disk_was_full_asks_to_be_started_again_and_has_lost_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    if "may mount no disk" in done.stderr:
        pytest.skip(done.stderr.strip())
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {
        "while full": False,  # It could not even open its files.
        "writes by itself": False,
        "with room": True,
        "started again": False,
        "writes then": True,
        "lost": 0,
        "first": "first",
    }
