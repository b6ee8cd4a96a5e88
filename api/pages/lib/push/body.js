/** The physics' worker as the page sees it, and its body as a motion that a figure follows (lib/replay/figure.js). */

const SETTLE_S = 0.1; // How long the camera takes to follow, so that it does not shake.

export class LiveMotion {
  constructor(about) {
    this.bodies = about.bodies;
    this.time = 0;
    this.look = null;
    this.lookedAt = 0;
  }

  /** @param {{time: number, positions: Float32Array, rotations: Float32Array, command: number[], motion: number[]}} said By the worker. */
  take({ time, positions, rotations, command, motion }) {
    if (time < this.time) this.look = null;
    Object.assign(this, { time, positions, rotations, command, motion });
  }

  poses(_, put) {
    this.bodies.forEach((number, body) => {
      put(body, this.positions.subarray(3 * number, 3 * number + 3), this.rotations.subarray(4 * number, 4 * number + 4));
    });
  }

  position(body) {
    const number = this.bodies[body];
    return [...this.positions.subarray(3 * number, 3 * number + 3)];
  }

  /** What the body is told and what it does; null of one that follows no command. */
  velocities = () => (this.command.length ? { commanded: this.command, measured: this.motion } : null);

  lookAt(_, body) {
    const here = this.position(body);
    const share = 1 - Math.exp((this.lookedAt - this.time) / SETTLE_S);
    this.look = this.look ? this.look.map((part, i) => part + share * (here[i] - part)) : here;
    this.lookedAt = this.time;
    return this.look;
  }

  target = () => null;
  contacts = () => 0;
  tendons = () => 0;
}

/** An episode for the stage that has no numbers but those of the moment. parts: as in a replay's header. */
export const episodeOf = (motion, parts) => ({ motion, parts, contact_count: [], time: [0], return: [0] });

/**
 * Starts the worker. hear: called with what it says; fail: with an Error.
 * @returns {{say: (object) => void, end: () => void}}
 */
export function startPhysics(recipe, policy, hear, fail) {
  const worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  worker.onmessage = ({ data }) => (data.failure ? fail(new Error(data.failure)) : hear(data));
  worker.onerror = (event) => fail(new Error(event.message || "The browser could not start MuJoCo."));
  worker.postMessage({ open: { recipe, policy } });
  return { say: (what) => worker.postMessage(what), end: () => worker.terminate() };
}
