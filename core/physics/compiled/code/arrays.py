"""The arrays that a program's code reads and writes."""

from core.physics.compiled.program import Assign, Program


def array_sizes(program: Program) -> dict[str, int]:
    """By input and output: how many numbers of an environment it holds, in the order of the code's pointers.

    Outputs have the prefix `to_`.
    """
    sizes = dict[str, int]()
    for one in program.statements:
        if isinstance(one, Assign) and one.operation == "input":
            name, place = str(one.arguments[0]), int(one.arguments[1])
            sizes[name] = max(sizes.get(name, 0), place + 1)
    return sizes | {f"to_{name}": len(variables) for name, variables in program.outputs.items()}
