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

const exact = new Intl.NumberFormat("en", { notation: "compact", maximumFractionDigits: 6 });

/** Ticks of an axis whose neighbours are `increment` apart: with as many digits as that takes, so that none lies. */
export function ticks(numbers, increment) {
  return numbers.map((number) => {
    if (number === null || number === 0) return number === null ? "" : "0";
    const size = Math.abs(number);
    const digits = Math.min(Math.max(Math.ceil(Math.log10(size / increment)) + 2, 2), 15);
    const precise = Number(number.toPrecision(digits)); // Without the noise of sums such as 0.1 + 0.2.
    return size < 1e-3 || size >= 1e6 ? precise.toExponential().replace("e+", "e") : String(precise);
  });
}

/** Ticks of steps, such as 1.25M. */
export const stepTicks = (numbers) => numbers.map((number) => exact.format(number));

/** What lies between ticks of seconds, so that minutes and hours come out whole. */
export const TIME_INCREMENTS = [
  ...[1e-3, 1e-2, 0.1].flatMap((one) => [one, 2 * one, 5 * one]),
  ...[1, 60].flatMap((unit) => [1, 2, 5, 10, 15, 30].map((one) => one * unit)),
  ...[1, 2, 3, 6, 12, 24, 48, 96, 240, 480, 960].map((hours) => hours * 3600),
];

/** Ticks of seconds: 45 s, 2:30 min, 1:15 h. */
export function timeTicks(numbers, increment) {
  const most = Math.max(...numbers);
  if (most < 120 || increment < 1) return ticks(numbers, increment).map((text) => `${text} s`);
  if (increment >= 3600) return numbers.map((number) => `${number / 3600} h`);
  if (increment >= 60 && most < 7200) return numbers.map((number) => `${number / 60} min`);
  const two = (part) => String(part).padStart(2, "0");
  return numbers.map((number) => {
    const [hours, minutes, rest] = [Math.floor(number / 3600), Math.floor(number / 60) % 60, Math.round(number % 60)];
    if (increment >= 60) return `${hours}:${two(minutes)} h`;
    return hours ? `${hours}:${two(minutes)}:${two(rest)} h` : `${minutes}:${two(rest)} min`;
  });
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

/** A user's model: the name that it was sent by; or else its body's, or the id's beginning where no worker has read it. */
export const modelName = ({ id, name, description }) => name || (description ? description.inventory.root : id.slice(0, 19));
