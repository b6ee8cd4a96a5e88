"""What goes wrong: each fault is done, lasts for a while, and is undone; all drawn from a seed."""

import random
import signal
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from tests.faults.campaign.proxy import Mode
from tests.faults.campaign.world import DISKS, PARTIES, SERVERS, STORES, World


@dataclass(frozen=True)
class Fault:
    """at_s, lasts_s: seconds from the episode's start, and until it is undone. aftermath_s: from then on."""

    name: str
    at_s: float
    lasts_s: float
    do: Callable[[World], None]
    undo: Callable[[World], None] = lambda world: None
    aftermath_s: float = 0.0


# By name: what draws a fault from its time and duration, and how often it is drawn.
Kinds = Mapping[str, tuple[Callable[[random.Random, float, float], Fault], int]]


@dataclass(frozen=True)
class Campaign:
    """The faults of an episode. spec: what each job says besides its seed; settings: of every process."""

    kinds: Kinds
    spec: Mapping[str, Any] = field(default_factory=dict[str, Any])
    settings: Mapping[str, str] = field(default_factory=dict[str, str])

    def draw(self, rng: random.Random, within_s: float) -> list[Fault]:
        """One to five faults, by the time at which they begin."""
        weights = [weight for _, weight in self.kinds.values()]
        names = rng.choices(list(self.kinds), weights=weights, k=rng.randint(1, 5))
        faults = [
            self.kinds[name][0](rng, rng.uniform(0.2, within_s), rng.choice((0.2, 1.0, 2.5, 5.0)))
            for name in names
        ]
        return sorted(faults, key=lambda fault: fault.at_s)


def campaign_of(name: str) -> Campaign:
    """The `CAMPAIGN` of a module of this folder."""
    return import_module(f"{__package__}.{name}").CAMPAIGN


def _killed(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    party = rng.choice(PARTIES)
    which = rng.choice((0, 0, 1, 2)) if party.startswith("worker") else 0
    return Fault(
        f"SIGKILL {party}[{which}]",
        at_s,
        0.0,
        lambda world: world.signal(party, signal.SIGKILL, which=which),
    )


def _drained(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    party = rng.choice(("worker-1", "worker-2"))
    return Fault(f"SIGTERM {party}", at_s, 0.0, lambda world: world.signal(party, signal.SIGTERM, which=0))


def _stopped(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    name = rng.choice((*PARTIES, *SERVERS))
    which = rng.choice((None, 0, 1, 2)) if name.startswith("worker") else None
    return Fault(
        f"SIGSTOP {name}[{which}] for {lasts_s:g} s",
        at_s,
        lasts_s,
        lambda world: world.signal(name, signal.SIGSTOP, which=which),
        lambda world: world.signal(name, signal.SIGCONT),
    )


def _server_killed(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    name = rng.choice(SERVERS)
    return Fault(f"SIGKILL {name}", at_s, 0.0, lambda world: world.signal(name, signal.SIGKILL, which=0))


def _flushed(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    def flush(world: World) -> None:
        with suppress(Exception), world.redis() as client:
            client.flushall()

    return Fault("FLUSHALL", at_s, 0.0, flush)


def _cut_off(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    """One party from one store, all from one store, or one party from all."""
    party, store = rng.choice((*PARTIES, "*")), rng.choice((*STORES, "*"))
    modes = [mode for mode in Mode if mode not in (Mode.OPEN, Mode.FLIP, Mode.LOSE_CLAIMS)]
    return misbehaving(party, store, rng.choice(modes), at_s, lasts_s)


def _flipped(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    """Of the object store alone: what it keeps has a hash. To the other two only TLS would show it."""
    return misbehaving(rng.choice((*PARTIES, "*")), "weed", Mode.FLIP, at_s, lasts_s)


def misbehaving(party: str, store: str, mode: Mode, at_s: float, lasts_s: float) -> Fault:
    def set_mode(world: World, wanted: Mode) -> None:
        for name, proxy in world.proxies.all.items():
            its_party, _, its_store = name.partition("/")
            if party in ("*", its_party) and store in ("*", its_store):
                proxy.mode = wanted

    return Fault(
        f"{mode} between {party} and {store} for {lasts_s:g} s",
        at_s,
        lasts_s,
        lambda world: set_mode(world, mode),
        lambda world: set_mode(world, Mode.OPEN),
    )


def _disk_full(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    return full_disk(rng.choice(list(DISKS)), at_s, lasts_s)


def full_disk(name: str, at_s: float, lasts_s: float) -> Fault:

    def fill(world: World) -> None:
        if name in world.disks:
            world.disks[name].fill()

    def free(world: World) -> None:
        if name in world.disks:
            world.disks[name].free()

    # SeaweedFS looks once a minute whether its disk has room, and believes what it saw until the next look.
    aftermath_s = 70.0 if name == "weed" else 0.0
    return Fault(f"disk of {name} full for {lasts_s:g} s", at_s, lasts_s, fill, free, aftermath_s)


def _clock_step(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    """Forward or back, and after a while to the right time again."""
    whose = rng.choice(("postgres", "postgres", *PARTIES))
    seconds = rng.choice((-7200.0, -10.0, 10.0, 7200.0))

    def step(world: World, by_s: float, to_s: float) -> None:
        if world.clocks:
            world.clocks.set(whose, to_s)
        elif whose == "postgres":
            _move_stored_times(world, by_s)

    return Fault(
        f"clock of {whose} steps by {seconds:g} s for {lasts_s:g} s",
        at_s,
        lasts_s,
        lambda world: step(world, seconds, seconds),
        lambda world: step(world, -seconds, 0.0),
    )


def _move_stored_times(world: World, by_s: float) -> None:
    """All that the database has stored: to it, its clock was set."""
    shift: tuple[Any, ...] = (by_s,)
    with suppress(Exception), world.database() as database, database.transaction():
        database.execute("UPDATE jobs SET lease_until = lease_until - make_interval(secs => %s)", shift)
        database.execute(
            "UPDATE pulse SET beat_at = beat_at - make_interval(secs => %s),"
            " quiet_until = quiet_until - make_interval(secs => %s)",
            shift * 2,
        )


_KINDS: Kinds = {
    "killed": (_killed, 4),
    "drained": (_drained, 1),
    "stopped": (_stopped, 3),
    "server_killed": (_server_killed, 2),
    "flushed": (_flushed, 2),
    "cut_off": (_cut_off, 6),
    "flipped": (_flipped, 2),
    "disk_full": (_disk_full, 2),
    "clock_step": (_clock_step, 2),
}

CAMPAIGN = Campaign(_KINDS)
