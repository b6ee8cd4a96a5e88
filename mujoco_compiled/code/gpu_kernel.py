"""A program as a kernel for NVIDIA's GPUs, with an environment in a thread, or in one for each limb."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from mujoco_compiled.code.arrays import array_sizes
from mujoco_compiled.code.long_writer import FunctionFrame, write_code
from mujoco_compiled.code.memory import memory_lines, small_table, small_tables, tables
from mujoco_compiled.code.steps import num_operations
from mujoco_compiled.code.target import Barrier, Target, Team
from mujoco_compiled.code.writer import Writer, routine_name, routines, seen
from mujoco_compiled.program.program import Program

TRIPLE = "nvptx64-nvidia-cuda"
# The threads that a card runs as one.
WARP = 32
_ALONE = Target(
    1,
    allowed="afn arcp",
    own="ptr addrspace(5)",
    tables="ptr addrspace(1)",
    shared="ptr addrspace(5)",
    common="ptr addrspace(5)",
)
# From about this many operations on, a card waits most of the time for instructions, which its cache cannot
# hold. Warps that stay together fetch them once: on an H200 the brittle star's kernel is 1.8 times as fast,
# the corridor's 1.2 times; the ant's, which fits, 0.9 times.
_LARGE = 20_000
_TOGETHER = replace(
    _ALONE,
    barrier=Barrier(
        every=1_000,
        wait="call void @llvm.nvvm.barrier.cta.sync.aligned.all(i32 0)",
        any="call i1 @llvm.nvvm.barrier.cta.red.or.aligned.all",
    ),
)
# Eight warps of 255 registers a thread fill a processor.
TEAM_WARPS = 8
_WAIT = "call void @llvm.nvvm.barrier.cta.sync.all(i32 0)"
# By compute capability, in KiB; 48 on every card.
_MOST_SHARED = {
    **{"7.5": 64, "8.0": 163, "8.6": 99, "8.7": 163, "8.9": 99},
    **{"9.0": 227, "10.0": 227, "10.3": 227, "12.0": 99, "12.1": 99},
}
_GLOBAL = "ptr addrspace(1)"
_LOCAL = "ptr addrspace(5)"
_READ = "i32 @llvm.nvvm.read.ptx.sreg"
_SHUFFLE = "llvm.nvvm.shfl.sync.bfly.f32"


@dataclass(frozen=True)
class _GpuRows:
    """Arrays [environments, size] in the card's memory.

    num_threads: threads per environment; those beyond `num_lanes` repeat lane 0. places,
    constants: tables of what differs between lanes, a row for each use.
    """

    sizes: Mapping[str, int]
    num_lanes: int
    num_threads: int
    places: list[Sequence[int]] = field(default_factory=list[Sequence[int]])
    constants: list[Sequence[float]] = field(default_factory=list[Sequence[float]])

    def load(self, writer: Writer, target: str, name: str, places: Sequence[int]) -> None:
        pointer = self._pointer(writer, name, places)
        writer.line(f"{target} = load float, {_GLOBAL} {pointer}, !invariant.load !0")

    def store(self, writer: Writer, name: str, places: Sequence[int], value: str) -> None:
        """The first lane writes what all lanes have."""
        pointer = self._pointer(writer, name, places)
        writes = "%writes" if len(places) == self.num_lanes else "%leads"
        done, written = writer.name()[1:], writer.name()[1:]
        writer.line(f"br i1 {writes}, label %{written}, label %{done}")
        writer.lines.append(f"{written}:")
        writer.line(f"store float {value}, {_GLOBAL} {pointer}")
        writer.line(f"br label %{done}")
        writer.lines.append(f"{done}:")
        writer.block = done

    def lane_constant(self, writer: Writer, target: str, values: Sequence[float]) -> None:
        self.constants.append(values)
        pointer = self._entry(writer, "constants", "float", len(self.constants) - 1)
        writer.line(f"{target} = load float, {_GLOBAL} {pointer}, !invariant.load !0")

    def lane_sum(self, writer: Writer, target: str, value: str) -> None:
        """In pairs, and pairs of pairs: every lane adds the same numbers in the same order."""
        distance = 1
        if self.num_threads > self.num_lanes:
            value = writer.value(f"select i1 %is_lane, float {value}, float 0.0")
        while distance < self.num_threads:
            other = writer.value(f"call float @{_SHUFFLE}(i32 %mask, float {value}, i32 {distance}, i32 31)")
            distance *= 2
            if distance < self.num_threads:
                value = writer.value(f"fadd float {value}, {other}")
            else:
                writer.line(f"{target} = fadd float {value}, {other}")

    def _pointer(self, writer: Writer, name: str, places: Sequence[int]) -> str:
        place = str(places[0])
        if len(places) > 1:
            self.places.append(places)
            entry = self._entry(writer, "places", "i64", len(self.places) - 1)
            place = writer.value(f"load i64, {_GLOBAL} {entry}, !invariant.load !0")
        row = f"[{self.sizes[name]} x float]"
        return writer.value(f"getelementptr {row}, {_GLOBAL} %{name}, i64 %environment, i64 {place}")

    def _entry(self, writer: Writer, table: str, element: str, row: int) -> str:
        kind = f"[{self.num_threads} x {element}]"
        return writer.value(f"getelementptr {kind}, {_GLOBAL} @{table}, i64 {row}, i64 %lane")

    def tables(self) -> list[str]:
        values = [[_ALONE.constant(value) for value in row] for row in self.constants]
        places = [[str(place) for place in row] for row in self.places]
        return [
            _table("places", "i64", [self._padded(row) for row in places], self.num_threads),
            _table("constants", "float", [self._padded(row) for row in values], self.num_threads),
        ]

    def _padded(self, row: list[str]) -> list[str]:
        """By thread."""
        return row + row[:1] * (self.num_threads - self.num_lanes)


def threads_of(num_lanes: int) -> int:
    """How many threads an environment takes: a power of 2, so that all exchange numbers in pairs."""
    return 1 << (num_lanes - 1).bit_length()


@dataclass(frozen=True)
class Block:
    """Threads of a card's processor that compute routines together. num_envs: each has one of these threads.
    near: how many numbers of `common` an environment has in what they share."""

    num_envs: int
    near: int
    shared_bytes: int


def block_of(program: Program, section_size: int | None, card: str, *, is_lean: bool) -> Block | None:
    """None: each thread goes alone. card: its compute capability. is_lean: whether a processor has more than
    one block."""
    memory, most = program.memory, most_shared(card)
    if section_size is not None or not program.routines:
        return None
    found = list[Block]()
    for num_envs in (WARP, WARP // 2, WARP // 4):
        room = most // (4 * num_envs) - memory.sizes["shared"]
        if room >= 0:
            near = max((end for end in (*memory.commons, memory.sizes["common"]) if end <= room), default=0)
            found.append(Block(num_envs, near, 4 * num_envs * (memory.sizes["shared"] + near)))
    # Threads of a warp without an environment are idle: fewer only where they get something near.
    best = next((block for block in found if block.near), next(iter(found), None))
    if best is None or not is_lean:
        return best
    return Block(best.num_envs, 0, 4 * best.num_envs * memory.sizes["shared"])


def most_shared(card: str) -> int:
    """What the threads of a block can share on cards of this compute capability, in bytes.

    Source: NVIDIA, CUDA C++ Programming Guide, "Compute Capabilities"; less what kernels have besides.
    """
    return 1024 * _MOST_SHARED.get(card, 48) - 64


def most_warps(program: Program, section_size: int | None) -> int:
    """The most warps of a block that stay together. Threads with lists of their own do not."""
    stay_together = section_size is None and not program.memory.lists
    return 8 if stay_together and num_operations(program.statements) > _LARGE else 1


def gpu_kernel(
    program: Program, name: str, section_size: int | None = None, block: Block | None = None
) -> str:
    """A module with the kernel `name(count, inputs..., outputs...)`, in the program's order.

    With a team, the first threads of a block have an environment each, and the others wait for routines; the
    last array is room for the blocks' `common`. block: see `block_of`.

    count: a pointer to the number of environments, int32. An input or output is a pointer to float32
    [environments, size]. Blocks have up to `most_warps` warps, of whose threads each environment takes
    `threads_of` the program's lanes. section_size: see `write_code`.
    """
    sizes, lanes, threads = array_sizes(program), program.num_lanes, threads_of(program.num_lanes)
    rows = _GpuRows(sizes, lanes, threads)
    names = ("count", *sizes, *(["room"] if block else []))
    arrays = ", ".join(f"{_GLOBAL} noalias %{one}" for one in names)
    environment = _environment(lanes, threads, block.num_envs if block else None)
    pointers = ", ".join(f"{_LOCAL} %{name}" for name in ("slots", "numbers", "counts", "shared", "common"))
    frame = FunctionFrame(f"{pointers}, {arrays}", environment, slots=_LOCAL)
    warps = TEAM_WARPS if block else most_warps(program, section_size)
    target = _in_team(program, block) if block else _TOGETHER if warps > 1 else _ALONE
    small = small_tables(program) if block else None
    writer = Writer(target, rows, block="main" if block else "body", routines=list(program.routines))
    code = write_code(program, writer, frame, section_size)
    # A thread gets all registers that there are: fewer would let more warps run at once, and spill.
    attributes = f'"nvvm.maxntid"="{warps * WARP}" "nvvm.minctasm"="1"'
    return "\n".join(
        [
            f'target triple = "{TRIPLE}"',
            *rows.tables(),
            *_ALONE.declarations(),
            *(f"declare {_READ}.{register}()" for register in ("tid.x", "ctaid.x", "ntid.x")),
            "declare void @llvm.nvvm.barrier.cta.sync.aligned.all(i32)",
            "declare i1 @llvm.nvvm.barrier.cta.red.or.aligned.all(i32, i1)",
            "declare void @llvm.nvvm.barrier.cta.sync.all(i32)",
            "declare i1 @llvm.nvvm.vote.any.sync(i32, i1)",
            f"declare float @{_SHUFFLE}(i32, float, i32, i32)",
            *(_TEAM if block else []),
            *tables(program.memory, _ALONE),
            *([small_table(small)] if small else []),
            *routines(program, replace(target, small=small), rows),
            *chain.from_iterable(code.functions),
            f"define ptx_kernel void @{name}({arrays}) {attributes} {{",
            "body:",
            *(_slots(code.num_slots) if code.functions else []),
            *memory_lines(program.memory, target),
            *environment,
            *(_serving(program, block, target) if block else []),
            *code.lines,
            *(["  call void @begin(i32 -1)"] if block else []),
            "  ret void",
            "}",
            "!0 = !{}",
            "",
        ]
    )


def _slots(number: int) -> list[str]:
    return [
        f"  %memory = alloca [{number} x float]",
        f"  %slots = addrspacecast ptr %memory to {_LOCAL}",
    ]


_TEAM = (
    "@room = external addrspace(3) global [0 x float], align 16",
    "@routine = internal addrspace(3) global i32 undef",
    "define internal void @begin(i32 %number) {",
    "  store i32 %number, ptr addrspace(3) @routine",
    f"  {_WAIT}",
    "  ret void",
    "}",
)


def _in_team(program: Program, block: Block) -> Target:
    calling = np.uint32(2**block.num_envs - 1).astype(np.int32)
    any_runs = f"call i1 @llvm.nvvm.vote.any.sync(i32 {calling}, i1"
    return replace(
        _ALONE,
        shared="ptr addrspace(3)",
        common=_GLOBAL,
        stride=block.num_envs,
        team=Team(wait=_WAIT, begin="call void @begin(i32", any=any_runs),
        near=block.near,
        after=program.memory.sizes["shared"],
    )


def _serving(program: Program, block: Block, target: Target) -> list[str]:
    """Threads that have no environment compute routines until there are no more."""
    numbers = range(len(program.routines))
    lines = [
        "  %shared = getelementptr float, ptr addrspace(3) @room, i32 %in_block",
        "  %blocks_before = zext i32 %block to i64",
        f"  %begin = mul i64 %blocks_before, {block.num_envs * program.memory.sizes['common']}",
        "  %own = zext i32 %in_block to i64",
        "  %place = add i64 %begin, %own",
        f"  %common = getelementptr float, {_GLOBAL} %room, i64 %place",
        # The first warp has part 0. Its threads without an environment leave: a warp waits in one place.
        f"  %of_others = sub i32 %thread, {WARP - block.num_envs}",
        f"  %own_part = udiv i32 %of_others, {block.num_envs}",
        "  %part = zext i32 %own_part to i64",
        f"  %threads_of_parts = sub i32 %num_threads, {WARP - block.num_envs}",
        f"  %all_parts = udiv i32 %threads_of_parts, {block.num_envs}",
        "  %num_parts = zext i32 %all_parts to i64",
        f"  %has_environment = icmp ult i32 %thread, {block.num_envs}",
        "  br i1 %has_environment, label %main, label %others",
        "others:",
        f"  %serves = icmp uge i32 %thread, {WARP}",
        "  br i1 %serves, label %serve, label %served",
        "serve:",
        f"  {_WAIT}",
        "  %which = load i32, ptr addrspace(3) @routine",
        f"  switch i32 %which, label %served [ {' '.join(f'i32 {k}, label %serve{k}' for k in numbers)} ]",
    ]
    for number, name in enumerate(program.routines):
        call = f"  call void {routine_name(name)}({seen(target)}, i64 %part, i64 %num_parts)"
        lines += [f"serve{number}:", call, "  br label %serve"]
    return [*lines, "served:", "  ret void", "main:"]


def _environment(lanes: int, threads: int, num_envs: int | None) -> list[str]:
    """Which environment the thread moves, and with which other threads. num_envs: of a block; None: any."""
    of_block = num_envs or "%num_threads"
    return [
        f"  %thread = call {_READ}.tid.x()",
        f"  %block = call {_READ}.ctaid.x()",
        f"  %num_threads = call {_READ}.ntid.x()",
        f"  %before = mul i32 %block, {of_block}",
        f"  %in_block = urem i32 %thread, {of_block}",
        "  %thread_of_all = add i32 %before, %in_block",
        f"  %number = udiv i32 %thread_of_all, {threads}",
        f"  %lane_number = urem i32 %thread, {threads}",
        "  %lane = zext i32 %lane_number to i64",
        # Lanes of an environment take the same way, and other environments another.
        f"  %in_warp = urem i32 %thread, {WARP}",
        "  %first = sub i32 %in_warp, %lane_number",
        f"  %mask = shl i32 {np.uint32(2**threads - 1).astype(np.int32)}, %first",
        f"  %environments = load i32, {_GLOBAL} %count",
        "  %exists = icmp slt i32 %number, %environments",
        "  %is_first = icmp eq i32 %lane_number, 0",
        "  %leads = and i1 %exists, %is_first",
        f"  %is_lane = icmp slt i32 %lane_number, {lanes}",
        "  %writes = and i1 %exists, %is_lane",
        # Threads without an environment compute the last one's, and write nothing.
        "  %last = sub i32 %environments, 1",
        "  %known = select i1 %exists, i32 %number, i32 %last",
        "  %environment = zext i32 %known to i64",
    ]


def _table(name: str, element: str, rows: Sequence[Sequence[str]], width: int) -> str:
    kind = f"[{width} x {element}]"
    values = ", ".join(f"{kind} [{', '.join(f'{element} {one}' for one in row)}]" for row in rows)
    content = f"[{values}]" if rows else "zeroinitializer"
    return f"@{name} = internal addrspace(1) constant [{len(rows)} x {kind}] {content}"
