/** Facts about a sweep's document that its views show. */

import { value } from "./format.js";

export const isOver = (sweep) => !["running", "cancelling"].includes(sweep.status);

export const objectivesOf = (sweep) => [sweep.spec.objective].flat();

export const axesOf = (sweep) => Object.keys(sweep.spec.parameters);

export const title = (sweep) => sweep.name || `${sweep.spec.method} over ${axesOf(sweep).map(short).join(", ")}`;

/** Whether its trials make videos, of which a trial may yet have none. */
export const hasVideos = (sweep) => sweep.spec.job.video !== null || "video" in sweep.spec.parameters;

/** The last part of a field's path: `learning_rate`. */
export const short = (axis) => axis.split(".").at(-1);

/** A setting as text. */
export const told = (setting) => (typeof setting === "object" && setting !== null ? JSON.stringify(setting) : value(setting));

/** The trials, the best by the first objective first; those without a value last. */
export function byObjective(sweep) {
  const sign = objectivesOf(sweep)[0].direction === "minimize" ? 1 : -1;
  const worth = (trial) => (typeof trial.values[0] === "number" ? sign * trial.values[0] : Infinity);
  return [...sweep.trials].sort((one, other) => worth(one) - worth(other) || one.number - other.number);
}

/** The best value after each trial that succeeded, in the order of their numbers: [[number, value, best]]. */
export function bestSoFar(sweep) {
  const better = objectivesOf(sweep)[0].direction === "minimize" ? Math.min : Math.max;
  let best;
  return sweep.trials
    .filter((trial) => trial.status === "succeeded" && typeof trial.values[0] === "number")
    .map(({ number, values: [found] }) => [number, found, (best = best === undefined ? found : better(best, found))]);
}
