"""Checks of the packages that add terms and bodies."""

from core.environments.plugins import installed
from gaitway.service.doctor.check import Check


def plugins() -> Check:
    """Whether each could be loaded, and without the numerical stack."""
    found = installed()
    if broken := [plugin for plugin in found if plugin.problem]:
        told = " ".join(f"{plugin.name} ({plugin.label}): {plugin.problem}" for plugin in broken)
        return Check("plugins", "fail", told, "Jobs that name it are refused; everything else works.")
    if heavy := [plugin for plugin in found if plugin.loads]:
        told = "; ".join(f"{plugin.name} imports {', '.join(plugin.loads)}" for plugin in heavy)
        remedy = "Import these in functions: each process of the API holds them in memory."
        return Check("plugins", "warn", told, remedy)
    named = ", ".join(f"{plugin.name} ({plugin.label})" for plugin in found)
    return Check("plugins", "pass", named or "none is installed")
