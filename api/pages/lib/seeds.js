/** Jobs that differ only in their seed, and their curves as one: the mean, between the least and the greatest. */

import { across, smooth } from "./curves.js";
import { seedsOf } from "./job.js";

/** The name of a seed's own value of a metric, in a job of several seeds. */
export const metricOfSeed = (seed, name) => `seed_${seed}/${name}`;

export const isOfASeed = (name) => /^seed_\d+\//.test(name);

/** A thin line for each of a job's seeds, which stand behind their mean. */
export function seedLines(curves, name, tools, job, colour = "--curve-1", before = "") {
  return seedsOf(job).flatMap((seed) => {
    const own = curves.byName.get(metricOfSeed(seed, name));
    if (!own) return [];
    const xs = across(own, tools.x, job.started_at || job.created_at);
    return [{ label: `${before}seed ${seed}`, xs, ys: smooth(own.values, tools.smoothing), colour, faint: true }];
  });
}

/** What identifies a setting: the specification without what a repetition changes. */
const settingOf = ({ spec }) => JSON.stringify(sorted({ ...spec, seed: 0, name: "", labels: {}, note: "" }));

const sorted = (value) =>
  value && typeof value === "object" && !Array.isArray(value)
    ? Object.fromEntries(Object.keys(value).sort().map((key) => [key, sorted(value[key])]))
    : value;

/** @returns {object[][]} The jobs of each setting, in the order in which the settings first come. */
export function bySetting(jobs) {
  const groups = new Map();
  for (const job of jobs) {
    const setting = settingOf(job);
    groups.set(setting, [...(groups.get(setting) || []), job]);
  }
  return [...groups.values()];
}

/**
 * Several curves as one, at every x of any of them. Between its values a curve is taken as straight; before its
 * first and after its last it does not count.
 * @param {{xs: number[], ys: (number | null)[]}[]} curves
 * @returns {{xs: number[], mean: number[], least: number[], greatest: number[]}}
 */
export function band(curves) {
  const finite = curves.map(({ xs, ys }) => xs.map((x, i) => [x, ys[i]]).filter(([, y]) => typeof y === "number"));
  const xs = [...new Set(finite.flatMap((points) => points.map(([x]) => x)))].sort((a, b) => a - b);
  const columns = finite.map((points) => along(points, xs));
  const rows = xs.map((_, i) => columns.map((column) => column[i]).filter((y) => y !== null));
  return {
    xs,
    mean: rows.map((row) => row.reduce((sum, y) => sum + y, 0) / row.length),
    least: rows.map((row) => Math.min(...row)),
    greatest: rows.map((row) => Math.max(...row)),
  };
}

/**
 * The lines of a chart for the curves of one setting, in the first one's colour: the edges of their band, and the mean.
 * @param {import("../parts/chart.js").Line[]} curves Two or more.
 */
export function bandLines(curves, label) {
  const { xs, mean, least, greatest } = band(curves);
  const { colour, isDashed } = curves[0];
  return [
    { label: `${label}: greatest`, xs, ys: greatest, colour, edge: "upper" },
    { label: `${label}: least`, xs, ys: least, colour, edge: "lower" },
    { label, xs, ys: mean, colour, isDashed },
  ];
}

/** The curve's values at rising xs; null outside it. */
function along(points, xs) {
  let next = 0;
  return xs.map((x) => {
    while (next < points.length && points[next][0] < x) next += 1;
    if (next === points.length) return null;
    const [right, above] = points[next];
    if (right === x) return above;
    if (next === 0) return null;
    const [left, below] = points[next - 1];
    return below + ((above - below) * (x - left)) / (right - left);
  });
}
