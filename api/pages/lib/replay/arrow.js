/** Arrows in a scene: of forces, and of velocities. */

import { ConeGeometry, CylinderGeometry, Group, Mesh, MeshPhongMaterial, Vector3 } from "../../vendor/three.js";

export const FORCE = 0xdb3d2e;
export const COMMANDED = 0x2f6fde;
export const MEASURED = 0xf0a020;

const UP = new Vector3(0, 1, 0);
const direction = new Vector3();

export class Arrow {
  /** @param {number} radius Of its tip, in m. */
  constructor(radius, colour) {
    const look = new MeshPhongMaterial({ color: colour });
    this.shaft = new Mesh(new CylinderGeometry(0.4 * radius, 0.4 * radius, 1, 12).translate(0, 0.5, 0), look);
    this.tip = new Mesh(new ConeGeometry(radius, 3 * radius, 16), look);
    this.root = new Group();
    this.root.add(this.shaft, this.tip);
    this.root.visible = false;
  }

  /** Stand at a point along a vector [3], with a length in m; nothing is seen of one that is shorter than its tip is wide. */
  show(at, along, length) {
    this.root.position.set(...at);
    this.root.quaternion.setFromUnitVectors(UP, direction.set(...along).normalize());
    this.shaft.scale.y = Math.max(length, 1e-6);
    this.tip.position.y = length;
    this.root.visible = true;
  }

  hide() {
    this.root.visible = false;
  }

  dispose() {
    for (const { geometry } of [this.shaft, this.tip]) geometry.dispose();
  }
}

/** The velocity that a body is told, and the one that it has: two arrows above its root. */
export class VelocityArrows {
  /** @param {object} world The scene's node in MuJoCo's axes. @param {number} radius Of the body, in m. */
  constructor(world, radius) {
    this.radius = radius;
    this.world = world;
    this.arrows = [COMMANDED, MEASURED].map((colour) => new Arrow(0.045 * radius, colour));
    for (const { root } of this.arrows) world.add(root);
  }

  /**
   * @param {number[]} at The root's position. @param {number[]} rotation Its quaternion w x y z.
   * @param {number[]} commanded Forward and left in m/s, along the root's own axes. @param {number[]} measured The same.
   */
  show(at, rotation, commanded, measured) {
    const across = heading(rotation);
    [commanded, measured].forEach(([forward, left], i) => {
      const [x, y] = [forward * Math.cos(across) - left * Math.sin(across), forward * Math.sin(across) + left * Math.cos(across)];
      const speed = Math.hypot(x, y);
      if (speed < 0.03) return this.arrows[i].hide();
      // One above the other, so that each is seen where they agree.
      const above = this.radius * (0.75 + 0.12 * i);
      this.arrows[i].show([at[0], at[1], at[2] + above], [x, y, 0], speed * this.radius);
    });
  }

  dispose() {
    for (const arrow of this.arrows) {
      this.world.remove(arrow.root);
      arrow.dispose();
    }
  }
}

/** The angle about the vertical of a body's own x axis. */
const heading = ([w, x, y, z]) => Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
