/** Reads a replay (docs/replay.md): its header first, an episode's numbers when it is shown. */

const MAGIC = "GWREPLAY";
const START = 16; // Bytes before the header.
const FIRST_PART = 65_536; // Holds the header of a dozen episodes.
const TYPES = { float32: Float32Array, int16: Int16Array, uint16: Uint16Array };

/**
 * @param {(first: number, last: number) => Promise<ArrayBuffer>} part Gives the file's bytes [first, last].
 * @returns {Promise<{about: object, episode: (number) => Promise<object>}>} `episode` gives the arrays by name, and
 *   `scale_m`, `parts`, `num_steps`, … of an episode, which it loads once. Raises Error if it is no replay.
 */
export async function readReplay(part) {
  let known = await part(0, FIRST_PART - 1);
  if (text(known, 0, 8) !== MAGIC) throw new Error("This file is not a replay.");
  const view = new DataView(known);
  const version = view.getUint32(8, true);
  if (version !== 1) throw new Error(`This replay has the version ${version}, which this page does not know.`);
  const first = START + view.getUint32(12, true);
  if (first > known.byteLength) known = await part(0, first - 1);
  const about = JSON.parse(text(known, START, first));
  const loaded = new Map();
  const load = async (number) => {
    const entry = about.episodes[number];
    const numbers = await part(first + entry.start, first + entry.start + entry.length - 1);
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

const text = (buffer, from, to) => new TextDecoder().decode(new Uint8Array(buffer, from, to - from));
