"""biorobot's brittle star with any number of arms. Importing this module needs biorobot."""

import numpy as np
from biorobot.brittle_star.mjcf.morphology.morphology import MJCFBrittleStarMorphology
from biorobot.brittle_star.mjcf.morphology.parts.arm import MJCFBrittleStarArm


class EvenStar(MJCFBrittleStarMorphology):
    """A star with a place for each arm; biorobot's has five. With five arms the two are equal."""

    def _build_arms(self) -> None:
        specification = self.morphology_specification
        radius = specification.disk_specification.radius.value
        angles = np.linspace(0, 2 * np.pi, specification.number_of_arms, endpoint=False)
        self.arms = [
            MJCFBrittleStarArm(
                parent=self._disk,
                name=f"arm_{index}",
                pos=radius * np.array([np.cos(angle), np.sin(angle), 0]),
                euler=[0, 0, angle],
                arm_index=index,
            )
            for index, angle in enumerate(angles)
        ]
