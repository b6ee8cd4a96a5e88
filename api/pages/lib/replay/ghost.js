/** A translucent copy of a body, where the clip is that it follows; videos have the same (core/rendering/ghost.py). */

import { MeshPhongMaterial } from "../../vendor/three.js";
import { clone } from "../../vendor/three-skeleton-utils.js";
import { Motion } from "./motion.js";

const COLOUR = 0x299e8f;
const OPACITY = 0.3;

export class Ghost {
  /** @param {object} about The replay's header. @param {object} episode One with a reference. */
  constructor(scene, about, episode) {
    const { reference_origin: origin, reference_position: position, reference_rotation: rotation } = episode;
    this.motion = new Motion({ ...episode, origin, position, rotation });
    this.root = clone(scene);
    this.bodies = about.reference_bodies.map((body) => this.root.getObjectByName(`body_${body}`));
    this.material = new MeshPhongMaterial({ color: COLOUR, transparent: true, opacity: OPACITY, depthWrite: false });
    const own = new Set();
    for (const body of this.bodies) body.traverse((node) => own.add(node));
    this.root.traverse((node) => {
      if (!node.isMesh) return;
      node.visible = own.has(node) || Boolean(node.isSkinnedMesh);
      node.material = this.material;
      node.castShadow = node.receiveShadow = false;
    });
  }

  /** Stand as the clip does at a moment. */
  show(time, isShown) {
    this.root.visible = isShown;
    if (!isShown) return;
    this.motion.poses(time, (body, [x, y, z], [w, i, j, k]) => {
      this.bodies[body].position.set(x, y, z);
      this.bodies[body].quaternion.set(i, j, k, w);
    });
  }

  dispose() {
    this.material.dispose();
  }
}
