/** Numbers and times as people read them. */

const whole = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });
const short = new Intl.NumberFormat("en", { notation: "compact", maximumFractionDigits: 1 });

export const count = (number) => whole.format(number);
export const compact = (number) => short.format(number);

/** Four digits at most, and an exponent where that says more. */
export function value(number) {
  if (number === null || number === undefined) return "–";
  if (typeof number !== "number") return String(number);
  const size = Math.abs(number);
  if (size !== 0 && (size < 1e-3 || size >= 1e6)) return Number(number.toPrecision(3)).toExponential().replace("e+", "e");
  return String(Number(number.toPrecision(4)));
}

/** @param {number} seconds */
export function duration(seconds) {
  if (seconds < 0.95) return `${Math.round(seconds * 1000)} ms`;
  if (seconds < 90) return `${Number(seconds.toPrecision(2))} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172_800) return `${(seconds / 3600).toFixed(1)} h`;
  return `${(seconds / 86_400).toFixed(1)} days`;
}

export function bytes(number) {
  if (number < 1000) return `${number} B`;
  const units = ["kB", "MB", "GB", "TB"];
  const power = Math.min(Math.floor(Math.log10(number) / 3), units.length);
  return `${Number((number / 1000 ** power).toPrecision(3))} ${units[power - 1]}`;
}

export const seconds = (from, to) => (new Date(to) - new Date(from)) / 1000;

/** How long ago, in words. */
export function ago(time) {
  const passed = seconds(time, Date.now());
  return passed < 5 ? "just now" : `${duration(passed)} ago`;
}

export const moment = (time) => new Date(time).toLocaleString();
