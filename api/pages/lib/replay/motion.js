/** Where things are in an episode at a moment. All in MuJoCo's axes: x, y, z up; rotations as w x y z. */

const UNITS = 32767;
const SPREAD_S = 0.4; // The camera's path is smoothed over this time, as in videos.

export class Motion {
  constructor(episode) {
    this.episode = episode;
    this.numFrames = episode.time.length;
    this.numBodies = episode.position.length / 3 / this.numFrames;
    this.duration = episode.time[this.numFrames - 1];
    this.unit = episode.scale_m / UNITS;
    this.firstContact = sums(episode.contact_count);
    this.firstSegment = sums(episode.tendon_count || []);
  }

  /** The frame before a moment, and the share of the way to the next one. */
  at(time) {
    const times = this.episode.time;
    let low = 0;
    let high = this.numFrames - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= time) low = middle;
      else high = middle;
    }
    if (high === low) return [0, 0];
    return [low, Math.min(1, Math.max(0, (time - times[low]) / (times[high] - times[low])))];
  }

  /** The frame that shows a moment best. */
  nearest(time) {
    const [frame, share] = this.at(time);
    return Math.min(this.numFrames - 1, frame + Math.round(share));
  }

  /** Call `put(body, position, quaternion)` for each body; the arrays [3] and [4] are used again. */
  poses(time, put) {
    const [frame, share] = this.at(time);
    const next = Math.min(frame + 1, this.numFrames - 1);
    for (let body = 0; body < this.numBodies; body++) {
      for (let axis = 0; axis < 3; axis++) place[axis] = mix(this.#position(frame, body, axis), this.#position(next, body, axis), share);
      this.#turn(frame, next, body, share);
      put(body, place, turn);
    }
  }

  /** Where a body is at a moment: a new array [3]. */
  position(time, body) {
    const [frame, share] = this.at(time);
    const next = Math.min(frame + 1, this.numFrames - 1);
    return [0, 1, 2].map((axis) => mix(this.#position(frame, body, axis), this.#position(next, body, axis), share));
  }

  /** The target [3] at a moment, or null. */
  target(time) {
    const { target } = this.episode;
    if (!target) return null;
    const [frame] = this.at(time);
    return target.subarray(3 * frame, 3 * frame + 3);
  }

  /** The velocities that the body is told and has, each [3] in its own frame, or null. */
  velocities(time) {
    const { command, velocity } = this.episode;
    if (!command) return null;
    const [frame] = this.at(time);
    return { commanded: command.subarray(3 * frame, 3 * frame + 3), measured: velocity.subarray(3 * frame, 3 * frame + 3) };
  }

  /** Call `put(index, position, normal)` for each point of contact; returns their number. */
  contacts(time, put) {
    const frame = this.nearest(time);
    const { origin, contact_position: points, contact_normal: normals } = this.episode;
    const first = this.firstContact[frame];
    const number = this.firstContact[frame + 1] - first;
    for (let index = 0; index < number; index++) {
      for (let axis = 0; axis < 3; axis++) {
        place[axis] = origin[3 * frame + axis] + this.unit * points[3 * (first + index) + axis];
        turn[axis] = normals[3 * (first + index) + axis] / UNITS;
      }
      put(index, place, turn);
    }
    return number;
  }

  /** Call `put(index, tendon, from, to)` for each straight part of a tendon; returns their number. */
  tendons(time, put) {
    const { tendon, tendon_segment: points } = this.episode;
    if (!tendon) return 0;
    const frame = this.nearest(time);
    const first = this.firstSegment[frame];
    const number = this.firstSegment[frame + 1] - first;
    for (let index = 0; index < number; index++) {
      const at = 6 * (first + index);
      put(index, tendon[first + index], points.subarray(at, at + 3), points.subarray(at + 3, at + 6));
    }
    return number;
  }

  /** What a camera that follows the body looks at: its path without its shaking. */
  lookAt(time, body) {
    this.path ||= smoothed(this, body);
    const [frame, share] = this.at(time);
    const next = Math.min(frame + 1, this.numFrames - 1);
    return [0, 1, 2].map((axis) => mix(this.path[3 * frame + axis], this.path[3 * next + axis], share));
  }

  #position(frame, body, axis) {
    const { origin, position } = this.episode;
    return origin[3 * frame + axis] + this.unit * position[3 * (frame * this.numBodies + body) + axis];
  }

  #turn(frame, next, body, share) {
    const { rotation } = this.episode;
    const a = 4 * (frame * this.numBodies + body);
    const b = 4 * (next * this.numBodies + body);
    let dot = 0;
    for (let k = 0; k < 4; k++) dot += rotation[a + k] * rotation[b + k];
    const sign = dot < 0 ? -1 : 1; // A quaternion and its opposite are the same rotation.
    let length = 0;
    for (let k = 0; k < 4; k++) {
      turn[k] = mix(rotation[a + k], sign * rotation[b + k], share);
      length += turn[k] * turn[k];
    }
    for (let k = 0; k < 4; k++) turn[k] /= Math.sqrt(length) || 1;
  }
}

const place = new Float64Array(3);
const turn = new Float64Array(4);
const mix = (a, b, share) => a + share * (b - a);

function sums(counts) {
  const found = new Uint32Array(counts.length + 1);
  counts.forEach((count, i) => (found[i + 1] = found[i] + count));
  return found;
}

/** A body's path [N × 3], each point the mean of its neighbours in time; extended at the ends by reflection. */
function smoothed(motion, body) {
  const { numFrames: n } = motion;
  const reach = Math.min(n - 1, Math.round((SPREAD_S * (n - 1)) / (motion.duration || 1)));
  const points = Array.from({ length: n }, (_, frame) => motion.position(motion.episode.time[frame], body));
  const end = points[n - 1];
  const point = (frame, axis) => {
    if (frame < 0) return 2 * points[0][axis] - points[-frame][axis];
    return frame < n ? points[frame][axis] : 2 * end[axis] - points[2 * (n - 1) - frame][axis];
  };
  const path = new Float64Array(3 * n);
  for (let frame = 0; frame < n; frame++) {
    for (let axis = 0; axis < 3; axis++) {
      let sum = 0;
      for (let near = -reach; near <= reach; near++) sum += point(frame + near, axis);
      path[3 * frame + axis] = sum / (2 * reach + 1);
    }
  }
  return path;
}
