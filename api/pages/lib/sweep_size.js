/** How much a sweep that is being written makes: its trials and their environment steps, as far as they are known. */

import { devicesOf, takesFractions } from "./schemas.js";

export const MOST_TRIALS = 1000;
export const DEFAULT_POINTS = 5; // Values of a grid along a range without `points` and `step`.
const LENGTH = "algorithm.num_timesteps";

/** The number of values that a grid takes along an axis; null where it does not say. */
export function numValues(axis, isFractional) {
  if (Array.isArray(axis)) return axis.length || null;
  const { low, high, log, step } = axis;
  const points = axis.points ?? DEFAULT_POINTS;
  if (![low, high].every(Number.isFinite) || low >= high) return null;
  if (step > 0) return Math.floor((high - low) / step + 1e-9) + 1;
  if (!(points >= 1)) return null;
  if (isFractional || ![low, high].every(Number.isInteger) || points === 1) return points;
  // Whole numbers between close bounds come more than once; each counts once.
  const between = (share) => (log ? Math.exp((1 - share) * Math.log(low) + share * Math.log(high)) : (1 - share) * low + share * high);
  return new Set(Array.from({ length: points }, (_, i) => rounded(between(i / (points - 1))))).size;
}

/** To the nearest whole number, halves to the even one, as the service rounds. */
function rounded(value) {
  const up = Math.round(value);
  return up - value === 0.5 && up % 2 !== 0 ? up - 1 : up;
}

/** Trials in all, or the most of them; null where that is not known. */
function numTrials({ method, parameters, population, budget }, fields) {
  const most = budget?.jobs > 0 ? budget.jobs : Infinity;
  const own = {
    grid: () => Object.entries(parameters).reduce((product, [path, axis]) => {
      const field = fields.find((one) => one.path === path);
      const number = numValues(axis, !field || takesFractions(field));
      return number === null || product === null ? null : product * number;
    }, Object.keys(parameters).length ? 1 : null),
    pbt: () => (population?.generations > 0 ? (population.size ?? 8) * population.generations : null),
  }[method];
  const number = own ? own() : most;
  return number === null || number === Infinity ? null : Math.min(number, most);
}

/** The steps of a trial on each device that it may run on; null where they are not known. */
function lengthsOf({ job }, environment) {
  if (job.kind === "rollout") return null;
  const said = job.algorithm?.num_timesteps;
  if (Number.isFinite(said)) return [said];
  const defaults = environment?.defaults?.[job.algorithm?.kind || "ppo"];
  const planned = devicesOf(job).map((device) => defaults?.[device]?.num_timesteps);
  return planned.every(Number.isFinite) ? planned : null;
}

/**
 * @returns {{trials: number | null, steps: number | null, each: number | null, dependsOnDevice: boolean, isMost: boolean}}
 *   each: the steps of one trial, on the device on which it takes most; isMost: whether all may be fewer.
 */
export function sizeOf(draft, fields, environment) {
  const trials = numTrials(draft, fields);
  const length = draft.parameters[LENGTH];
  const lengths = lengthsOf(draft, environment);
  const one = lengths && Math.max(...lengths);
  const isPopulation = draft.method === "pbt";
  let each = isPopulation && one !== null ? Math.ceil(one / (draft.population?.generations || 1)) : one;
  let steps = trials === null || one === null ? null : isPopulation ? trials * (one / draft.population.generations) : trials * one;
  if (length) {
    // Every length comes as often as every other one, in a grid.
    const isKnown = draft.method === "grid" && Array.isArray(length) && length.every(Number.isFinite) && trials !== null;
    steps = isKnown && !(draft.budget?.jobs > 0) ? (trials / length.length) * length.reduce((sum, value) => sum + value, 0) : null;
    each = null;
  }
  const limit = draft.budget?.steps > 0 ? draft.budget.steps : Infinity;
  const dependsOnDevice = lengths !== null && Math.min(...lengths) < one;
  const isMost = dependsOnDevice || Boolean(draft.pruning) || limit < steps || draft.budget?.gpu_hours > 0;
  return { trials, each, dependsOnDevice, steps: steps === null ? (limit === Infinity ? null : limit) : Math.min(steps, limit), isMost };
}
