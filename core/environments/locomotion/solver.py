"""How far the solver goes for Brax's ant and humanoid."""

from core.physics.engine import SolverSettings

# Brax's settings for MJX, where each iteration is dear. `compiled` goes as far as MuJoCo needs: with two
# iterations a policy learns to do what MuJoCo does not let it do, and falls there.
BRAX_SOLVER = SolverSettings(
    iterations=1,
    ls_iterations=4,
    implicit_damping=False,
    compiled=SolverSettings(iterations=4, ls_iterations=8, implicit_damping=True),
)
