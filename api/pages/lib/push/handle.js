/** Taking hold of a body on the stage: by mouse, pen or finger; and the arrow of the force that follows. */

import { Plane, Raycaster, Vector2, Vector3 } from "../../vendor/three.js";
import { Arrow, FORCE } from "../replay/arrow.js";

const UP = new Vector3(0, 1, 0);

export class Handle {
  /** @param {(pull: object | null) => void} onPull See Simulation.setPull. */
  constructor(stage, onPull) {
    this.stage = stage;
    this.figure = stage.figures[0];
    this.onPull = onPull;
    this.held = null;
    this.arrow = new Arrow(0.06 * stage.about.view.radius, FORCE);
    this.figure.world.add(this.arrow.root);
    this.area = stage.renderer.domElement.parentElement;
    // Before the camera's controls hear of it, which are below: whoever holds a body does not turn the camera.
    this.area.addEventListener("pointerdown", this.#take, true);
    this.area.addEventListener("pointermove", this.#move, true);
    for (const end of ["pointerup", "pointercancel"]) this.area.addEventListener(end, this.#leave, true);
  }

  /** Show the force {at, force} in MuJoCo's axes, or none; and pull to where the pointer is now. weight: in N. */
  show(force, weight) {
    if (this.held) this.#pull();
    if (!force) return this.arrow.hide();
    const strength = Math.hypot(...force.force) / weight;
    this.arrow.show(force.at, force.force, Math.min(1.2, strength) * this.stage.about.view.radius);
  }

  /** A direction on the screen [right, away] as a unit vector [3] on the ground, in MuJoCo's axes. */
  onTheGround([right, away]) {
    const forward = this.stage.camera.getWorldDirection(new Vector3()).setY(0).normalize();
    const across = forward.clone().cross(UP);
    const { x, z } = forward.multiplyScalar(away).addScaledVector(across, right);
    return [x, -z, 0];
  }

  dispose() {
    this.area.removeEventListener("pointerdown", this.#take, true);
    this.area.removeEventListener("pointermove", this.#move, true);
    for (const end of ["pointerup", "pointercancel"]) this.area.removeEventListener(end, this.#leave, true);
    this.figure.world.remove(this.arrow.root);
    this.arrow.dispose();
  }

  #take = (event) => {
    if (event.button !== 0 || !event.isPrimary) return;
    this.pointer = this.#place(event);
    const ray = this.#ray();
    for (const { object, point } of ray.intersectObject(this.figure.root, true)) {
      const node = this.#bodyOf(object);
      if (!node) continue;
      this.held = { id: event.pointerId, node, body: Number(node.name.slice(5)), point: node.worldToLocal(point.clone()) };
      event.stopPropagation();
      event.preventDefault();
      this.area.focus({ preventScroll: true });
      this.area.setPointerCapture(event.pointerId);
      this.#pull();
      return;
    }
  };

  #move = (event) => {
    if (event.pointerId !== this.held?.id) return;
    event.stopPropagation();
    this.pointer = this.#place(event);
    this.#pull();
  };

  #leave = (event) => {
    if (event.pointerId !== this.held?.id) return;
    event.stopPropagation();
    this.held = null;
    this.onPull(null);
  };

  /** To the pointer, in the plane through the held point that faces the camera. */
  #pull() {
    const { node, body, point } = this.held;
    const here = node.localToWorld(point.clone());
    const facing = new Plane().setFromNormalAndCoplanarPoint(this.stage.camera.getWorldDirection(new Vector3()), here);
    const to = this.#ray().ray.intersectPlane(facing, new Vector3());
    if (to) this.onPull({ body, point: point.toArray(), to: this.figure.world.worldToLocal(to).toArray() });
  }

  /** The node of the moving body that a mesh belongs to. */
  #bodyOf(object) {
    for (let node = object; node; node = node.parent) if (this.figure.bodies.includes(node)) return node;
    return null;
  }

  #place({ clientX, clientY }) {
    const { left, top, width, height } = this.area.getBoundingClientRect();
    return new Vector2((2 * (clientX - left)) / width - 1, 1 - (2 * (clientY - top)) / height);
  }

  #ray() {
    const ray = new Raycaster();
    ray.setFromCamera(this.pointer, this.stage.camera);
    return ray;
  }
}
