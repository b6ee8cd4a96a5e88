"""Pictures of a model's positions, by `mujoco.Renderer`. MUJOCO_GL must be set before this is imported."""

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.rendering import arrows, floor, ghost
from core.rendering.gl import context_works
from core.rendering.request import Overlay
from core.rendering.scene import TARGET_BODY, CameraView, Floats, prepare, quality_of

ModelFields = Mapping[str, NDArray[np.floating[Any]]]

# The colour behind models without a sky.
_BACKDROP = np.array([0.62, 0.74, 0.87, 1.0], dtype=np.float32)


_FLAGS: dict[Overlay, mujoco.mjtVisFlag] = {
    "joints": mujoco.mjtVisFlag.mjVIS_JOINT,
    "contacts": mujoco.mjtVisFlag.mjVIS_CONTACTPOINT,
    "centre_of_mass": mujoco.mjtVisFlag.mjVIS_COM,
    "transparent": mujoco.mjtVisFlag.mjVIS_TRANSPARENT,
}


def drawing_options(show: Sequence[Overlay]) -> mujoco.MjvOption:
    """MuJoCo's options for what is drawn besides the body; of joints all, whatever group they are in."""
    options = mujoco.MjvOption()
    for overlay in show:
        options.flags[_FLAGS[overlay]] = 1
    options.jointgroup[:] = 1
    return options


class MujocoRenderer:
    """Draws one model; holds a GL context until `close`.

    camera: the number of a camera of the model, or None for the one that follows the body. show: what is
    drawn besides the body.
    The model is changed (light, colours, buffer sizes): pass a copy.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        view: CameraView,
        *,
        camera: int | None,
        width: int,
        height: int,
        show: Sequence[Overlay] = (),
    ) -> None:
        self._gl_renderer = context_works()
        prepare(model, view, quality_of(self._gl_renderer), width=width, height=height)
        if camera is not None:  # A camera of the model may see farther than `track`.
            model.vis.map.shadowclip *= 3
        self._model = model
        self._data = mujoco.MjData(model)
        self._ghost: ghost.Ghost | None = None
        self._view = view
        self._camera = camera
        self._options = drawing_options(show)
        self._finds_contacts = "contacts" in show
        self._renderer = mujoco.Renderer(model, height, width, max_geom=10_000)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0  # a white line between floor and sky
        self._has_sky = mujoco.mjtTexture.mjTEXTURE_SKYBOX in model.tex_type

    @property
    def gl_renderer(self) -> str:
        """The name that the GL driver reports; `llvmpipe` means software."""
        return self._gl_renderer

    def frame(
        self,
        qpos: NDArray[np.float64],
        look_at: Floats | None = None,
        target: Floats | None = None,
        velocities: Floats | None = None,
        reference: Floats | None = None,
    ) -> NDArray[np.uint8]:
        """RGB [height, width, 3] of the positions qpos [nq].

        look_at: the point [3] in metres that the camera `track` looks at; by default the body itself.
        target: the point [2 or 3] where the body named `target` stands, if the model has one; else a ball
        marks it. velocities: [2, 3], what the tracked body is told and what it does; see `EpisodeMotion`.
        reference: positions [nq] at which a translucent copy of the body is drawn as well.
        """
        has_mark = target is None or self._put_target(target)
        mark = target
        self._place(qpos)
        target = self.target() if look_at is None else look_at
        eye: Any = self._follow(target) if self._camera is None else self._camera
        scene = self._renderer.scene
        seen_from = np.array(scene.camera[0].pos)
        self._renderer.update_scene(self._data, eye, self._options)
        if np.abs(seen_from - scene.camera[0].pos).max() > self._view.radius:
            # A floor without an end is drawn around where the eye was before.
            self._renderer.update_scene(self._data, eye, self._options)
        for light in range(scene.nlight):
            if scene.lights[light].type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL:
                # Shadows are drawn only around the light's position, which the body walks away from.
                direction = np.array(scene.lights[light].dir)
                scene.lights[light].pos[:] = target - 12 * self._view.radius * direction
        if self._view.floor is not None:
            floor.lay(scene, self._view.floor, target, self._view.radius)
        if not self._has_sky:
            self._hang_backdrop(target)
        if reference is not None and self._view.body is not None:
            if self._ghost is None:
                self._ghost = ghost.Ghost(self._model, self._view.body)
            self._ghost.add(scene, reference)
        if velocities is not None and (body := self._view.body) is not None:
            arrows.add(scene, self._view, self._data.xpos[body], self._data.xmat[body], velocities)
        if mark is not None and not has_mark:
            arrows.mark(scene, self._view, mark)
        return self._renderer.render()

    def change_model(self, fields: ModelFields) -> None:
        """From here on, draw the model with these fields, which are named as in MuJoCo."""
        for name, values in fields.items():
            getattr(self._model, name)[:] = values

    def path(self, qpos: Floats) -> Floats:
        """Where the body is [N, 3] at each of the positions [N, nq]."""
        points = np.empty((len(qpos), 3))
        for row, positions in enumerate(qpos):
            self._place(positions)
            points[row] = self.target()
        return points

    def target(self) -> Floats:
        """The point [3] that the camera `track` looks at now."""
        body = self._view.body
        return self._view.centre if body is None else np.array(self._data.xpos[body])

    def close(self) -> None:
        self._renderer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _put_target(self, target: Floats) -> bool:
        """Move the model's target to where it was in the episode's environment; whether it has one."""
        number = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_BODY, TARGET_BODY)
        if number > 0 and self._model.body_parentid[number] == 0:
            self._model.body_pos[number, : len(target)] = target
        return number > 0

    def _place(self, qpos: Floats) -> None:
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        mujoco.mj_tendon(self._model, self._data)
        if self._finds_contacts:
            mujoco.mj_collision(self._model, self._data)

    def _follow(self, target: Floats) -> mujoco.MjvCamera:
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = target
        camera.azimuth, camera.elevation = self._view.azimuth, self._view.elevation
        camera.distance = self._view.distance
        return camera

    def _hang_backdrop(self, target: Floats) -> None:
        scene = self._renderer.scene
        if scene.ngeom >= scene.maxgeom:
            return
        eye = scene.camera[0]
        forward, up = np.array(eye.forward, dtype=np.float64), np.array(eye.up, dtype=np.float64)
        far = 0.9 * float(eye.frustum_far)
        frame = np.stack([np.cross(up, -forward), up, -forward], axis=1)
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(
            geom,
            mujoco.mjtGeom.mjGEOM_PLANE,
            np.array([far, far, 0.0]) * 4,
            np.array(eye.pos) + far * forward,
            frame.ravel(),
            _BACKDROP,
        )
        geom.emission, geom.specular = 0.3, 0.0
        scene.ngeom += 1
