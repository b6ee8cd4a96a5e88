/** A trained policy from `policy.npz` (docs/export.md): some layers, which need no runtime of their own. */

const ACTIVATIONS = {
  swish: (x) => x / (1 + Math.exp(-x)),
  relu: (x) => Math.max(x, 0),
  tanh: Math.tanh,
  elu: (x) => (x > 0 ? x : Math.expm1(x)),
  gelu: (x) => x * (0.5 + 0.5 * Math.tanh(Math.sqrt(2 / Math.PI) * (x + 0.044715 * x ** 3))),
  leaky_relu: (x) => (x > 0 ? x : 0.01 * x),
  selu: (x) => 1.0507009873554805 * (x > 0 ? x : 1.6732632423543772 * Math.expm1(x)),
  sigmoid: (x) => 1 / (1 + Math.exp(-x)),
  softplus: (x) => Math.max(x, 0) + Math.log1p(Math.exp(-Math.abs(x))),
};

/** @param {ArrayBuffer} bytes The file. Returns {about, act: (observation) => action}. Raises Error for others. */
export function readPolicy(bytes) {
  const arrays = readNpz(bytes);
  const about = JSON.parse(arrays.about || "{}");
  if (about.format !== "gaitway-policy" || ![1, 2].includes(about.version)) throw new Error("This file is not a policy that the page knows.");
  const { num_layers: numLayers, activation, normalized_max_abs: bound } = about.network;
  const bend = ACTIVATIONS[activation];
  if (!bend) throw new Error(`The page has no activation ${activation}.`);
  const named = (prefix, number) =>
    Array.from({ length: number }, (_, i) => [arrays[`${prefix}kernel_${i}`], arrays[`${prefix}bias_${i}`]]);
  const layers = named("", numLayers);
  const { num_layers: numEncoding, encoded } = about.network.encoder ?? { num_layers: 0, encoded: [] };
  const encoder = named("encoder_", numEncoding);
  const isEncoded = new Set(encoded);
  const { observation_mean: mean, observation_std: std } = arrays;
  const most = bound ?? Infinity;
  const act = (observation) => {
    let values = observation.map((value, i) => Math.min(Math.max((value - mean[i]) / std[i], -most), most));
    if (encoder.length) {
      const others = values.filter((_, i) => !isEncoded.has(i));
      values = [...means(encoder, encoded.map((i) => values[i]), bend), ...others];
    }
    return means(layers, values, bend).map(Math.tanh);
  };
  return { about, act };
}

/** The first half of what the layers give; the other half are deviations, with which training explores. */
function means(layers, values, bend) {
  layers.forEach(([kernel, bias], i) => {
    values = times(values, kernel, bias);
    if (i < layers.length - 1) values = values.map(bend);
  });
  return values.slice(0, values.length / 2);
}

/** values [n] · kernel [n × m] + bias [m]. */
function times(values, kernel, bias) {
  const result = Float64Array.from(bias);
  const width = bias.length;
  for (let row = 0; row < values.length; row++) {
    const value = values[row];
    const first = row * width;
    for (let column = 0; column < width; column++) result[column] += value * kernel[first + column];
  }
  return result;
}

/** The arrays of an uncompressed .npz by name: Float32Array in C order, or text. */
function readNpz(bytes) {
  const view = new DataView(bytes);
  const text = (from, length) => new TextDecoder().decode(new Uint8Array(bytes, from, length));
  const found = {};
  // The directory at the end of a zip: 22 bytes, if nobody wrote a comment, as NumPy does not.
  const end = bytes.byteLength - 22;
  if (end < 0 || view.getUint32(end, true) !== 0x06054b50) throw new Error("This file is not an .npz.");
  let at = view.getUint32(end + 16, true);
  for (let left = view.getUint16(end + 10, true); left > 0; left--) {
    const [nameLength, extraLength, commentLength] = [28, 30, 32].map((place) => view.getUint16(at + place, true));
    if (view.getUint16(at + 10, true) !== 0) throw new Error("This .npz is compressed.");
    const entry = view.getUint32(at + 42, true);
    const first = entry + 30 + view.getUint16(entry + 26, true) + view.getUint16(entry + 28, true);
    found[text(at + 46, nameLength).replace(/\.npy$/, "")] = readArray(bytes, view, first, text);
    at += 46 + nameLength + extraLength + commentLength;
  }
  return found;
}

function readArray(bytes, view, first, text) {
  const header = text(first + 10, view.getUint16(first + 8, true)); // Of version 1: a Python literal.
  const data = first + 10 + header.length;
  const shape = header.match(/'shape': \(([^)]*)\)/)[1].split(",").filter((part) => part.trim());
  const count = shape.reduce((product, part) => product * Number(part), 1);
  const [, kind, size] = header.match(/'descr': '<([fU])(\d+)'/) || [];
  if (header.includes("'fortran_order': True") || !kind) throw new Error("This .npz has arrays that the page does not read.");
  if (kind === "U") return String.fromCodePoint(...new Uint32Array(bytes.slice(data, data + 4 * Number(size))));
  const numbers = bytes.slice(data, data + Number(size) * count);
  return size === "4" ? new Float32Array(numbers) : new Float64Array(numbers);
}
