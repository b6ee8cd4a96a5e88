"""Instructions in order, and the names of their results."""

from dataclasses import dataclass, field

from mujoco_compiled.code.target import Target


@dataclass
class Lines:
    """Instructions for a target, and those of a program's variables that are constants."""

    target: Target
    lines: list[str] = field(default_factory=list[str], kw_only=True)
    _num_names: int = field(default=0, kw_only=True)
    _constants: dict[int, str] = field(default_factory=dict[int, str], kw_only=True)

    def name(self) -> str:
        self._num_names += 1
        return f"%t{self._num_names}"

    def line(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def value(self, text: str) -> str:
        """The name of the instruction's result."""
        name = self.name()
        self.line(f"{name} = {text}")
        return name

    def operand(self, variable: int | float | str) -> str:
        """The variable's name, or its value if it is a constant."""
        return self._constants.get(int(variable)) or f"%v{variable}"

    def select(self, target: str, condition: str, chosen: str, otherwise: str) -> None:
        number, truth = self.target.number, self.target.truth
        self.line(f"{target} = select {truth} {condition}, {number} {chosen}, {number} {otherwise}")

    def any(self, truth: str) -> str:
        """Whether it is true for an environment of the vector."""
        if self.target.width == 1:
            return truth
        reduce = f"@llvm.vector.reduce.or.v{self.target.width}i1"
        return self.value(f"call i1 {reduce}({self.target.truth} {truth})")
