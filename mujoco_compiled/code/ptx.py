"""PTX, NVIDIA's assembly, from LLVM's language. Needs the extra `compiled`."""

from typing import Any

import llvmlite.binding as llvm

from mujoco_compiled.code.gpu_kernel import TRIPLE


def ptx(module: str, compute_capability: str) -> str:
    """PTX for cards of this compute capability, such as "9.0". Raises RuntimeError for a wrong module."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine: Any = llvm.Target.from_triple(TRIPLE).create_target_machine(
        cpu=f"sm_{compute_capability.replace('.', '')}", opt=2
    )
    parsed: Any = llvm.parse_assembly(module)
    parsed.verify()
    return machine.emit_assembly(parsed)
