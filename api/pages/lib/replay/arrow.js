/** Arrows in a scene: of forces, and of velocities; core/rendering/arrows.py draws the latter in videos. */

import { ConeGeometry, Curve, CylinderGeometry, Group, Mesh, MeshPhongMaterial, TubeGeometry, Vector3 } from "../../vendor/three.js";

export const FORCE = 0xdb3d2e;
const COMMANDED = 0x2f6fde;
const MEASURED = 0xf0a020;

// In radii of the body: the length of an arrow for each m/s, heights above the body, and the arc's radius.
const LENGTH = 1;
const ABOVE = [0.14, 0.3];
const ARC = 0.55;
const TOP = 0.6; // Of the body above its root, where a replay's header does not have it.
const TIP = 0.05;
// Below this, in m/s and rad/s, nothing is drawn; of a faster turn than this, in rad/s, no more.
const SLOWEST = 0.03;
const FASTEST_TURN = 5.5;
const ARC_PARTS = 48;

const UP = new Vector3(0, 1, 0);
const direction = new Vector3();

export class Arrow {
  /** @param {number} radius Of its tip, in m. */
  constructor(radius, colour) {
    const look = lookOf(colour);
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

/** By how much a body turns in a second: an arc about the vertical, from where it faces. */
class Turn {
  /** @param {number} reach The arc's radius. @param {number} radius Of its tip, in m. */
  constructor(reach, radius, colour) {
    const look = lookOf(colour);
    const geometry = new TubeGeometry(new Arc(reach), ARC_PARTS, 0.36 * radius, 8);
    this.indicesPerPart = geometry.index.count / ARC_PARTS;
    this.line = new Mesh(geometry, look);
    this.tip = new Mesh(new ConeGeometry(radius, 3 * radius, 16).translate(0, 1.5 * radius, 0), look);
    this.tipAngle = (3 * radius) / reach;
    this.reach = reach;
    this.root = new Group();
    this.root.add(this.line, this.tip);
    this.root.visible = false;
  }

  /** @param {number[]} at The middle. @param {number} facing The angle at which it begins. @param {number} turn In rad. */
  show(at, facing, turn) {
    const angle = Math.min(Math.abs(turn), FASTEST_TURN);
    const neck = Math.max(0, angle - this.tipAngle);
    this.root.position.set(...at);
    this.root.rotation.z = facing;
    this.root.scale.y = Math.sign(turn);
    this.line.geometry.setDrawRange(0, Math.round((neck / FASTEST_TURN) * ARC_PARTS) * this.indicesPerPart);
    const [from, to] = [neck, angle].map((part) => new Vector3(this.reach * Math.cos(part), this.reach * Math.sin(part), 0));
    const size = Math.min(1, angle / this.tipAngle); // The tip of a short arc is smaller.
    this.tip.position.copy(from);
    this.tip.quaternion.setFromUnitVectors(UP, direction.copy(to).sub(from).normalize());
    this.tip.scale.setScalar(size);
    this.root.visible = true;
  }

  hide() {
    this.root.visible = false;
  }

  dispose() {
    for (const { geometry } of [this.line, this.tip]) geometry.dispose();
  }
}

class Arc extends Curve {
  constructor(reach) {
    super();
    this.reach = reach;
  }

  getPoint(share, point = new Vector3()) {
    const angle = share * FASTEST_TURN;
    return point.set(this.reach * Math.cos(angle), this.reach * Math.sin(angle), 0);
  }
}

/** The velocity that a body is told, and the one that it has: for each an arrow and an arc above the body. */
export class VelocityArrows {
  /** @param {object} world The scene's node in MuJoCo's axes. @param {{radius: number, top?: number}} view Of the body, in m. */
  constructor(world, { radius, top = TOP * radius }) {
    this.radius = radius;
    this.top = top;
    this.world = world;
    this.arrows = [COMMANDED, MEASURED].map((colour) => new Arrow(TIP * radius, colour));
    this.turns = [COMMANDED, MEASURED].map((colour) => new Turn(ARC * radius, TIP * radius, colour));
    for (const { root } of [...this.arrows, ...this.turns]) world.add(root);
  }

  /**
   * @param {number[]} at The root's position. @param {number[]} rotation Its quaternion w x y z.
   * @param {number[]} commanded Forward and left in m/s, along the root's own axes; turn in rad/s. @param {number[]} measured The same.
   */
  show(at, rotation, commanded, measured) {
    const facing = heading(rotation);
    [commanded, measured].forEach(([forward, left, turn], i) => {
      // One above the other, so that each is seen where they agree.
      const middle = [at[0], at[1], at[2] + this.top + ABOVE[i] * this.radius];
      const speed = Math.hypot(forward, left);
      const way = facing + Math.atan2(left, forward);
      if (speed < SLOWEST) this.arrows[i].hide();
      else this.arrows[i].show(middle, [Math.cos(way), Math.sin(way), 0], LENGTH * speed * this.radius);
      if (Math.abs(turn) < SLOWEST) this.turns[i].hide();
      else this.turns[i].show(middle, facing, turn);
    });
  }

  dispose() {
    for (const arrow of [...this.arrows, ...this.turns]) {
      this.world.remove(arrow.root);
      arrow.dispose();
    }
  }
}

const lookOf = (colour) => new MeshPhongMaterial({ color: colour, emissive: colour, emissiveIntensity: 0.3 });

/** The angle about the vertical of a body's own x axis. */
const heading = ([w, x, y, z]) => Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
