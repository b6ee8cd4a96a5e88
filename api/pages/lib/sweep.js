/** Facts about a sweep's document that its views show. */

import { value } from "./format.js";

export const isOver = (sweep) => !["running", "cancelling"].includes(sweep.status);

export const objectivesOf = (sweep) => [sweep.spec.objective].flat();

export const axesOf = (sweep) => Object.keys(sweep.spec.parameters);

export const title = (sweep) => sweep.name || `${sweep.spec.method} over ${axesOf(sweep).map(short).join(", ") || "seeds"}`;

/** Whether its trials make videos, of which a trial may yet have none. */
export const hasVideos = (sweep) => sweep.spec.job.video !== null || "video" in sweep.spec.parameters;

/** The last part of a field's path: `learning_rate`. */
export const short = (axis) => axis.split(".").at(-1);

/** A setting as text. */
export const told = (setting) => (typeof setting === "object" && setting !== null ? JSON.stringify(setting) : value(setting));

/** Whether a trial has a job, which may be deleted. */
export const hasJob = (trial) => trial.job && trial.status !== "deleted";

/** Of which objective the address speaks: its place among them. */
export const chosenObjective = (sweep, query) =>
  Math.max(objectivesOf(sweep).findIndex(({ metric }) => metric === query.get("objective")), 0);

/** Whether a trial has a value of every objective. */
export const isMeasured = (trial) => trial.values.length > 0 && trial.values.every((one) => typeof one === "number");

/** The trials, the best by one objective first; those without a value last. */
export function byObjective(sweep, objective) {
  const sign = objectivesOf(sweep)[objective].direction === "minimize" ? 1 : -1;
  const worth = (trial) => (typeof trial.values[objective] === "number" ? sign * trial.values[objective] : Infinity);
  return [...sweep.trials].sort((one, other) => worth(one) - worth(other) || one.number - other.number);
}

/** The best value of an objective after each trial that succeeded, in the order of their numbers: [[number, value, best]]. */
export function bestSoFar(sweep, objective) {
  const better = objectivesOf(sweep)[objective].direction === "minimize" ? Math.min : Math.max;
  let best;
  return sweep.trials
    .filter((trial) => trial.status === "succeeded" && typeof trial.values[objective] === "number")
    .map(({ number, values: { [objective]: found } }) => [number, found, (best = best === undefined ? found : better(best, found))]);
}
