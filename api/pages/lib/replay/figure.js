/** One episode on the stage: a copy of the scene that stands as the episode's poses say. */

import {
  CylinderGeometry,
  DynamicDrawUsage,
  InstancedMesh,
  Matrix4,
  Mesh,
  MeshPhongMaterial,
  Quaternion,
  SphereGeometry,
  Vector3,
} from "../../vendor/three.js";
import { clone } from "../../vendor/three-skeleton-utils.js";
import { VelocityArrows } from "./arrow.js";
import { Ghost } from "./ghost.js";
import { Motion } from "./motion.js";

const CONTACT = 0xe6993a;
const TARGET = 0xdb3d2e;
const most = (counts) => counts.reduce((greatest, count) => Math.max(greatest, count), 0);
const UP = new Vector3(0, 1, 0);

export class Figure {
  /**
   * @param {object} about The replay's header.
   * @param {boolean} isFirst The first one shows the surroundings; the others only where theirs differ.
   */
  constructor(scene, about, episode, isFirst) {
    this.about = about;
    this.motion = episode.motion || new Motion(episode);
    this.root = clone(scene);
    this.world = this.root.getObjectByName("world");
    this.bodies = about.bodies.map((body) => this.root.getObjectByName(`body_${body}`));
    this.tracked = about.bodies.indexOf(about.tracked_body);
    this.endless = [];
    this.root.traverse((node) => node.userData.endless && this.endless.push(node));
    this.move(episode.parts);
    if (!isFirst && !episode.parts.length) this.#hideSurroundings();
    const { radius } = about.view;
    this.contacts = this.#add(new CylinderGeometry(0.07 * radius, 0.07 * radius, 0.015 * radius, 16), CONTACT, most(episode.contact_count));
    this.tendons = this.#add(new CylinderGeometry(1, 1, 1, 8), 0xffffff, most(episode.tendon_count || []));
    this.ghost = episode.reference_position ? new Ghost(scene, about, episode) : null;
    if (this.ghost) this.root.add(this.ghost.root);
    this.target = about.target_body === null ? this.#mark(0.07 * radius, episode) : this.root.getObjectByName(`body_${about.target_body}`);
  }

  /** Put parts of the scene elsewhere. parts: as in a replay's header. */
  move(parts) {
    for (const { node, translation, rotation, scale } of parts) {
      const found = this.root.getObjectByName(node);
      found?.position.fromArray(translation);
      found?.scale.fromArray(scale);
      if (rotation) found?.quaternion.fromArray(rotation);
    }
  }

  /** Show what the tracked body is told and what it does. */
  #showVelocities(time) {
    const velocities = this.motion.velocities(time);
    if (!velocities || this.tracked < 0) return;
    this.velocities ||= new VelocityArrows(this.world, this.about.view);
    const { position, quaternion: { w, x, y, z } } = this.bodies[this.tracked];
    this.velocities.show(position.toArray(), [w, x, y, z], velocities.commanded, velocities.measured);
  }

  /** Stand as at a moment; after the end, as at the end. */
  show(time, { contacts, ghost }) {
    this.motion.poses(time, (body, [x, y, z], [w, i, j, k]) => {
      this.bodies[body].position.set(x, y, z);
      this.bodies[body].quaternion.set(i, j, k, w);
    });
    this.#showVelocities(time);
    this.ghost?.show(time, ghost);
    const target = this.motion.target(time);
    if (target) this.target?.position.fromArray(target);
    this.contacts.visible = contacts;
    if (contacts) this.#place(this.contacts, this.motion.contacts(time, (index, at, normal) => this.#disc(index, at, normal)));
    this.#place(this.tendons, this.motion.tendons(time, (index, tendon, from, to) => this.#line(index, tendon, from, to)));
  }

  /** What a camera that follows looks at: [3] in MuJoCo's axes. */
  lookAt(time) {
    const { follows, centre } = this.about.view;
    return follows && this.tracked >= 0 ? this.motion.lookAt(time, this.tracked) : centre;
  }

  /** Move endless floors along with the camera, by whole tiles. */
  recentre([x, y]) {
    for (const node of this.endless) {
      const [across, along] = node.userData.endless;
      node.position.x = Math.round(x / across) * across;
      node.position.y = Math.round(y / along) * along;
    }
  }

  dispose() {
    for (const mesh of [this.contacts, this.tendons, this.mark]) mesh?.geometry.dispose();
    this.contacts.dispose();
    this.tendons.dispose();
    this.velocities?.dispose();
    this.ghost?.dispose();
  }

  #hideSurroundings() {
    const moving = new Set(this.bodies);
    for (const body of this.world.children) {
      if (moving.has(body) || body.name === `body_${this.about.target_body}`) continue;
      for (const child of body.children) child.visible = false;
    }
  }

  #add(geometry, colour, most) {
    const mesh = new InstancedMesh(geometry, new MeshPhongMaterial({ color: colour }), Math.max(1, most));
    mesh.instanceMatrix.setUsage(DynamicDrawUsage);
    mesh.frustumCulled = false;
    mesh.count = 0;
    this.world.add(mesh);
    return mesh;
  }

  #mark(radius, episode) {
    if (!episode.target) return null;
    const look = new MeshPhongMaterial({ color: TARGET, transparent: true, opacity: 0.7 });
    this.mark = new Mesh(new SphereGeometry(radius, 20, 14), look);
    this.world.add(this.mark);
    return this.mark;
  }

  #disc(index, at, normal) {
    quaternion.setFromUnitVectors(UP, direction.set(normal[0], normal[1], normal[2]));
    this.contacts.setMatrixAt(index, matrix.compose(point.fromArray(at), quaternion, scale.set(1, 1, 1)));
  }

  #line(index, tendon, from, to) {
    const { rgba, width } = this.about.tendons[tendon];
    direction.fromArray(to).sub(point.fromArray(from));
    const length = direction.length() || 1e-9;
    point.addScaledVector(direction, 0.5);
    quaternion.setFromUnitVectors(UP, direction.divideScalar(length));
    this.tendons.setMatrixAt(index, matrix.compose(point, quaternion, scale.set(width, length, width)));
    this.tendons.setColorAt(index, this.tendons.material.color.clone().setRGB(...rgba.slice(0, 3)));
  }

  #place(mesh, count) {
    mesh.count = count;
    mesh.instanceMatrix.needsUpdate = true;
    if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
  }
}

const quaternion = new Quaternion();
const matrix = new Matrix4();
const direction = new Vector3();
const point = new Vector3();
const scale = new Vector3();
