"""How far the solver goes for Brax's ant and humanoid."""

from core.physics.engine import SolverSettings

# Brax's settings for MJX, where each iteration is dear. `compiled` goes nearly as far as MuJoCo: a humanoid
# that learned with two iterations fell in MuJoCo itself.
BRAX_SOLVER = SolverSettings(
    iterations=1,
    ls_iterations=4,
    implicit_damping=False,
    compiled=SolverSettings(iterations=4, ls_iterations=8, implicit_damping=True),
)
