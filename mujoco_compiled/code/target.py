"""How a kind of processor takes numbers, and how its threads meet, in LLVM's words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

_INTRINSICS = ("sqrt", "fabs", "fma")


@dataclass(frozen=True)
class Barrier:
    """How threads that run side by side wait for each other, in LLVM's words.

    every: operations from one barrier to the next; a shorter loop goes on in each thread for itself. wait:
    the call. any: of a truth value, whether it is true in one of the threads, which meet there, too.
    """

    every: int
    wait: str
    any: str


@dataclass(frozen=True)
class Team:
    """How several threads compute a routine, in LLVM's words.

    wait: the call in which all meet. begin: tells the others which routine comes, by a number. any: of a
    truth value, whether it is true in one of the threads that call routines.
    """

    wait: str
    begin: str
    any: str


@dataclass(frozen=True)
class SmallTables:
    """Integers that a card reads for all its threads at once. places: where those of `integers` are."""

    places: Mapping[int, int]
    values: Sequence[int]


@dataclass(frozen=True)
class Target:
    """How a kind of processor takes numbers.

    width: environments in a vector; 1: no vector. allowed: what a division and a square root may do besides
    rounding correctly, in LLVM's words. barrier: None: a thread does not wait for others. own: the kind
    of pointers to what environments that are computed together have; tables: to the model's. shared, common:
    to these spaces, in which an environment's numbers are `stride` apart. team: None: the thread that calls a
    routine computes it. small: tables that lie nearer than `integers`.
    near: how many numbers of `common` are in `shared`, from number `after` on.
    """

    width: int
    allowed: str
    barrier: Barrier | None = None
    own: str = "ptr"
    tables: str = "ptr"
    shared: str = "ptr"
    common: str = "ptr"
    stride: int = 1
    team: Team | None = None
    small: SmallTables | None = None
    near: int = 0
    after: int = 0

    @property
    def number(self) -> str:
        return self.of("float")

    @property
    def integer(self) -> str:
        return self.of("i32")

    @property
    def truth(self) -> str:
        return self.of("i1")

    @property
    def suffix(self) -> str:
        """The end of an intrinsic function's name."""
        return "f32" if self.width == 1 else f"v{self.width}f32"

    def of(self, element: str) -> str:
        return element if self.width == 1 else f"<{self.width} x {element}>"

    def constant(self, value: float) -> str:
        # LLVM writes a float32 as the bits of the equal float64.
        return self.splat("float", f"0x{np.float64(np.float32(value)).view(np.uint64):016X}")

    def splat(self, element: str, value: str) -> str:
        return value if self.width == 1 else f"splat ({element} {value})"

    def declarations(self) -> list[str]:
        """LLVM's declarations of the functions that `Writer` calls."""
        number = self.number
        found = [f"declare {number} @llvm.{one}.{self.suffix}({number})" for one in _INTRINSICS[:2]]
        found.append(f"declare {number} @llvm.fma.{self.suffix}({number}, {number}, {number})")
        if self.width > 1:
            found.append(f"declare i1 @llvm.vector.reduce.or.v{self.width}i1({self.truth})")
        return found
