"""Which sentence each refusal of a real Valkey becomes."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import redis

from core.adapters.redis.errors import reaching_redis
from core.adapters.rq.queue import RQQueue
from core.adapters.startup import exercise_queue
from core.adapters.wiring import connect_redis
from core.errors import Misconfigured, RecordsRefuse, RecordsUnavailable
from core.jobs.queue import queue_name
from gaitway.service.embedded.valkey import Valkey


@contextmanager
def configured(client: redis.Redis, name: str, value: str) -> Iterator[None]:
    before = client.config_get(name)[name]
    client.config_set(name, value)
    try:
        yield
    finally:
        client.config_set(name, before)


@contextmanager
def answering(answer: bytes) -> Iterator[int]:
    """A server that says this to whoever comes, whatever it is asked; its port."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(answer)
                connection.recv(4096)  # Until the other side hangs up.

        thread = threading.Thread(target=serve)
        thread.start()
        yield listener.getsockname()[1]
        thread.join()


def test_a_probe_of_the_queue_leaves_nothing(redis_client: redis.Redis) -> None:
    exercise_queue(redis_client)
    assert redis_client.dbsize() == 0


def test_too_little_memory_names_maxmemory_and_passes_with_time(redis_client: redis.Redis) -> None:
    with (
        configured(redis_client, "maxmemory", "1"),
        pytest.raises(RecordsUnavailable, match="raise its maxmemory") as caught,
    ):
        exercise_queue(redis_client)
    assert not isinstance(caught.value, RecordsRefuse)


def test_a_refusal_in_the_midst_of_a_pipeline_is_known_too(redis_client: redis.Redis) -> None:
    queue = RQQueue(redis_client)
    with (
        configured(redis_client, "min-replicas-to-write", "1"),
        pytest.raises(RecordsUnavailable, match="min-replicas-to-write"),
    ):
        queue.enqueue("019aa3c2f0b1-5be0c1d2e3", 1, name=queue_name("any", "normal"))


def test_a_replica_is_named(redis_client: redis.Redis) -> None:
    redis_client.replicaof("127.0.0.1", "1")
    try:
        with pytest.raises(RecordsUnavailable, match="leads to a replica"):
            exercise_queue(redis_client)
    finally:
        redis_client.replicaof("NO", "ONE")


def test_a_user_without_the_right_is_told_which_it_was(redis_client: redis.Redis, valkey: Valkey) -> None:
    redis_client.acl_setuser("guest", enabled=True, nopass=True, keys="*", categories=["+@all"])
    redis_client.acl_setuser("guest", enabled=True, nopass=True, keys="*", commands=["-info"])
    try:
        with (
            connect_redis(valkey.url.replace("unix://", "unix://guest:any@"), retries=0) as guest,
            pytest.raises(RecordsRefuse, match="'info' command"),
            reaching_redis(),
        ):
            guest.info()
    finally:
        redis_client.acl_deluser("guest")


def test_a_database_that_is_not_there_is_named(redis_client: redis.Redis, valkey: Valkey) -> None:
    with (
        connect_redis(f"{valkey.url}?db=99", retries=0) as client,
        pytest.raises(RecordsRefuse, match="no database with the number"),
    ):
        exercise_queue(client)


def test_a_key_that_somebody_else_has_written_names_the_remedy(redis_client: redis.Redis) -> None:
    redis_client.set("rq:queues", "no set")
    with pytest.raises(RecordsUnavailable, match="Give Gaitway a database of its own") as caught:
        RQQueue(redis_client).known()
    assert not isinstance(caught.value, RecordsRefuse)


def test_our_own_mistakes_pass_through(redis_client: redis.Redis) -> None:
    with pytest.raises(redis.ResponseError, match="wrong number of arguments"), reaching_redis():
        redis_client.execute_command("SET", "only-a-key")


def test_what_is_no_redis_is_refused() -> None:
    with (
        answering(b"HTTP/1.1 400 Bad Request\r\n\r\n") as port,
        connect_redis(f"redis://127.0.0.1:{port}", retries=0) as client,
        pytest.raises(RecordsRefuse, match="is not Redis"),
    ):
        exercise_queue(client)


def test_tls_asked_of_a_redis_without_it_is_named() -> None:
    # A real one waits for the end of a command; here the client's patience is short.
    with (
        socket.create_server(("127.0.0.1", 0)) as silent,
        redis.Redis.from_url(
            f"rediss://127.0.0.1:{silent.getsockname()[1]}", socket_timeout=0.2, retry=None
        ) as client,
        pytest.raises(RecordsUnavailable, match="begin the address with redis://"),
    ):
        exercise_queue(client)


@pytest.mark.parametrize(
    "url", ["redis://:se#cret@h:1", "redis://:se/cret@h:1", "redis://h:port", "redis://h:99999"]
)
def test_an_unreadable_address_is_refused_without_showing_a_piece_of_its_password(url: str) -> None:
    with pytest.raises(Misconfigured) as caught:
        connect_redis(url)
    assert "GAITWAY_REDIS_URL cannot be read" in caught.value.detail
    assert "se" not in caught.value.detail.replace("redis", "")
