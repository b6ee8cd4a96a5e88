/** What keys, buttons and a gamepad tell a body to do: a command within the ranges from which training drew it. */

/** By the `code` of a key, which is its place on a keyboard; and by number of the command which way it goes. */
export const KEYS = {
  KeyW: [1, 0, 0],
  ArrowUp: [1, 0, 0],
  KeyS: [-1, 0, 0],
  ArrowDown: [-1, 0, 0],
  KeyA: [0, 1, 0],
  ArrowLeft: [0, 1, 0],
  KeyD: [0, -1, 0],
  ArrowRight: [0, -1, 0],
  KeyQ: [0, 0, 1],
  KeyE: [0, 0, -1],
};
const REST = 0.15; // A stick that is left alone does not stand exactly in its middle.

export class Steering {
  /** @param {{low: number, high: number}[]} ranges Of each number of the command. */
  constructor(ranges) {
    this.ranges = ranges;
    this.held = new Set();
  }

  press(code) {
    this.held.add(code);
  }

  release(code) {
    this.held.delete(code);
  }

  releaseAll() {
    this.held.clear();
  }

  /** The command now: 0 of a velocity that nothing asks for. */
  command() {
    const ways = [...this.held].map((code) => KEYS[code]);
    const stick = gamepad();
    return this.ranges.map(({ low, high }, i) => {
      if (i >= stick.length) return (low + high) / 2; // A height or a pitch.
      const sum = ways.reduce((total, way) => total + (way[i] ?? 0), stick[i] ?? 0);
      const share = Math.min(1, Math.max(-1, sum));
      return share === 0 ? 0 : Math.min(high, Math.max(low, share > 0 ? share * high : -share * low));
    });
  }
}

/** The left stick walks, the right one turns; each in [-1, 1]. */
function gamepad() {
  const pad = navigator.getGamepads?.().find((one) => one?.connected);
  if (!pad) return [0, 0, 0];
  return [pad.axes[1], pad.axes[0], pad.axes[2]].map((value = 0) => (Math.abs(value) < REST ? 0 : -value));
}
