/** Reads a replay (docs/replay.md): its header first, an episode's numbers when it is shown. */

import { send } from "../api.js";

const MAGIC = "GWREPLAY";
const START = 16; // Bytes before the header.
const FIRST_PART = 65_536; // Holds the header of a dozen episodes.
const TYPES = { float32: Float32Array, int16: Int16Array, uint16: Uint16Array };

/**
 * @param {string} href The file's address.
 * @returns {Promise<{about: object, episode: (number) => Promise<object>}>} `episode` gives the arrays by name, and
 *   `scale_m`, `parts`, `num_steps`, … of an episode, which it loads once. Raises Error if it is no replay.
 */
export async function openReplay(href, signal) {
  let known = await part(href, 0, FIRST_PART - 1, signal);
  if (text(known, 0, 8) !== MAGIC) throw new Error("This file is not a replay.");
  const view = new DataView(known);
  const version = view.getUint32(8, true);
  if (version !== 1) throw new Error(`This replay has the version ${version}, which this page does not know.`);
  const first = START + view.getUint32(12, true);
  if (first > known.byteLength) known = await part(href, 0, first - 1, signal);
  const about = JSON.parse(text(known, START, first));
  const loaded = new Map();
  const load = async (number) => {
    const entry = about.episodes[number];
    const numbers = await part(href, first + entry.start, first + entry.start + entry.length - 1, signal);
    const arrays = Object.entries(entry.arrays).map(([name, { type, shape, start }]) => {
      const length = shape.reduce((product, size) => product * size, 1);
      return [name, new TYPES[type](numbers, start, length)];
    });
    return { ...entry, ...Object.fromEntries(arrays) };
  };
  return {
    about,
    episode: (number) => {
      if (!loaded.has(number)) loaded.set(number, load(number));
      return loaded.get(number);
    },
  };
}

/** Bytes [first, last] of a file, also where the service sends all of it. */
async function part(href, first, last, signal) {
  const answer = await send(href, { signal, range: [first, last] });
  const bytes = await answer.arrayBuffer();
  return answer.status === 206 ? bytes : bytes.slice(first, last + 1);
}

const text = (buffer, from, to) => new TextDecoder().decode(new Uint8Array(buffer, from, to - from));
