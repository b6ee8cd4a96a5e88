"""The arrays that a program's code reads and writes."""

from mujoco_compiled.program.program import Assign, Program


def array_sizes(program: Program) -> dict[str, int]:
    """By input and output: how many numbers of an environment it holds, in the order of the code's pointers.

    Outputs have the prefix `to_`.
    """
    sizes = dict[str, int]()
    for one in program.statements:
        if isinstance(one, Assign) and one.operation in ("input", "lane_input"):
            name, *places = one.arguments
            sizes[str(name)] = max(sizes.get(str(name), 0), *(int(place) + 1 for place in places))
    outputs = program.outputs.items()
    return sizes | {f"to_{name}": sum(len(one.places) for one in several) for name, several in outputs}
