"""Reads and stores of a program's spaces, as LLVM's instructions."""

from mujoco_compiled.code.lines import Lines
from mujoco_compiled.program.program import Bound, Place, Read, Space, Store


def read(lines: Lines, step: Read) -> None:
    target, name, tables = lines.target, f"%v{step.target}", lines.target.tables
    match step.space:
        case "numbers" | "shared" | "common":
            kind, pointer = _own(lines, step.space, step.place)
            lines.line(f"{name} = load {target.number}, {kind} {pointer}, align {4 * target.width}")
        case "constants" if step.index is not None:
            _look_up(lines, name, place_of(lines, step.place), lines.operand(step.index))
        case "constants":
            pointer = _pointer(lines, "float", tables, "@table_constants", place_of(lines, step.place))
            load = f"load float, {tables} {pointer}, align 4, !invariant.load !0"
            _spread(lines, name, lines.value(load))
        case "counts":
            pointer = _pointer(lines, "i32", target.own, "%counts", place_of(lines, step.place))
            number = _bounded(lines, lines.value(f"load i32, {target.own} {pointer}, align 4"), step.bound)
            if not step.is_number:
                lines.line(f"{name} = zext i32 {number} to i64")
            else:
                _spread(lines, name, lines.value(f"uitofp i32 {number} to float"))
        case "integers" if target.small:
            near = Place(target.small.places[step.place.offset], step.place.terms)
            pointer = _pointer(lines, "i16", "ptr addrspace(4)", "@small_integers", place_of(lines, near))
            number = lines.value(f"load i16, ptr addrspace(4) {pointer}, align 2, !invariant.load !0")
            lines.line(f"{name} = zext i16 {number} to i64")
        case "integers":
            pointer = _pointer(lines, "i32", tables, "@table_integers", place_of(lines, step.place))
            number = lines.value(f"load i32, {tables} {pointer}, align 4, !invariant.load !0")
            lines.line(f"{name} = sext i32 {number} to i64")


def _look_up(lines: Lines, name: str, place: str, index: str) -> None:
    """Each environment's constant: that at a place, or as much later as the index's whole part is."""
    target, tables, width = lines.target, lines.target.tables, lines.target.width
    whole = lines.value(f"fptosi {target.number} {index} to {target.integer}")
    begin = _pointer(lines, "float", tables, "@table_constants", place)
    pointer = lines.value(f"getelementptr inbounds float, {tables} {begin}, {target.integer} {whole}")
    if width == 1:
        lines.line(f"{name} = load float, {tables} {pointer}, align 4, !invariant.load !0")
        return
    every = f"{target.truth} {target.splat('i1', 'true')}, {target.number} zeroinitializer"
    lines.line(
        f"{name} = call {target.number} @llvm.masked.gather.v{width}f32.v{width}p0("
        f"<{width} x ptr> {pointer}, i32 4, {every})"
    )


def _spread(lines: Lines, name: str, number: str) -> None:
    """One number, as that of all environments."""
    kind, width = lines.target.number, lines.target.width
    if width == 1:
        lines.line(f"{name} = bitcast float {number} to float")
        return
    first = lines.value(f"insertelement {kind} poison, float {number}, i64 0")
    zeros = f"<{width} x i32> zeroinitializer"
    lines.line(f"{name} = shufflevector {kind} {first}, {kind} poison, {zeros}")


def _bounded(lines: Lines, number: str, bound: Bound | None) -> str:
    if bound is None:
        return number
    kind, most = bound
    is_beyond = lines.value(f"icmp ugt i32 {number}, {most}")
    chosen = (f"{most}", number) if kind == "most" else (number, "0")
    return lines.value(f"select i1 {is_beyond}, i32 {chosen[0]}, i32 {chosen[1]}")


def store(lines: Lines, step: Store) -> None:
    target = lines.target
    if isinstance(step.value, int):
        kind, pointer = _own(lines, step.space, step.place)
        value = f"{target.number} {lines.operand(step.value)}"
        lines.line(f"store {value}, {kind} {pointer}, align {4 * target.width}")
    else:
        pointer = _pointer(lines, "i32", target.own, "%counts", place_of(lines, step.place))
        number = lines.value(f"trunc i64 {place_of(lines, step.value)} to i32")
        lines.line(f"store i32 {number}, {target.own} {pointer}, align 4")


def _own(lines: Lines, space: Space, place: Place) -> tuple[str, str]:
    """The kind of pointer to an environment's own numbers, and the one to a place among them."""
    target = lines.target
    if space == "numbers":
        return target.own, _pointer(lines, target.number, target.own, "%numbers", place_of(lines, place))
    if space == "common" and place.offset < target.near:
        space, place = "shared", place + target.after
    kind = target.shared if space == "shared" else target.common
    row = target.number if target.stride == 1 else f"[{target.stride} x {target.number}]"
    return kind, _pointer(lines, row, kind, f"%{space}", place_of(lines, place))


def _pointer(lines: Lines, element: str, kind: str, begin: str, place: str) -> str:
    return lines.value(f"getelementptr inbounds {element}, {kind} {begin}, i64 {place}")


def place_of(lines: Lines, place: Place) -> str:
    """The integer's name, or the integer itself."""
    whole = ""
    for variable, stride in place.terms:
        term = f"%v{variable}" if stride == 1 else lines.value(f"mul nsw i64 %v{variable}, {stride}")
        whole = lines.value(f"add nsw i64 {whole}, {term}") if whole else term
    if not whole:
        return str(place.offset)
    return lines.value(f"add nsw i64 {whole}, {place.offset}") if place.offset else whole
