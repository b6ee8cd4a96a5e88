/** Facts about a job's document that several views show: names, files, settings, why it waits. */

import { get } from "./api.js";
import { isFinal } from "./events.js";
import { moment } from "./format.js";

export const RETURNS = ["eval/episode_reward", "training/episode_reward"];

/** The environment's id, which a specification gives bare or in an object. */
export const environmentOf = (spec) =>
  typeof spec.environment === "string" ? spec.environment : spec.environment?.id || "?";

export const optionsOf = (spec) => (typeof spec.environment === "object" && spec.environment?.options) || {};

/** The job's name, or what it does. */
export const title = (job) => job.name || `${environmentOf(job.spec)}, ${job.kind}`;

/** The job's labels; of an imported one, without those that name a sweep of the service that it came from. */
export function labelsOf({ labels, imported_from: origin }) {
  if (!origin) return labels;
  const { sweep, trial, ...own } = labels;
  return sweep === undefined ? labels : own;
}

/** The algorithm's kind; none for a rollout. */
export const algorithmOf = (job) => (job.kind === "train" ? job.spec.algorithm?.kind || "ppo" : null);

export const isOver = (job) => isFinal(job.status);

/** The seeds that the job trains side by side; none for a job with a single seed. */
export const seedsOf = (job) => job.spec.seeds || [];

/** The job with the files of one of its seeds, by default the first, and those that all share; `shownSeed` is that seed. */
export function ofSeed(job, seed = job.shownSeed) {
  const seeds = seedsOf(job);
  if (!seeds.length) return job;
  const shownSeed = seeds.includes(seed) ? seed : seeds[0];
  return { ...job, shownSeed, artifacts: job.artifacts.filter(({ metadata }) => (metadata.seed ?? shownSeed) === shownSeed) };
}

/** The newest file of a role, or the one of a step; of several seeds, that of the seed that is shown. */
export function newest(job, role, step) {
  const found = ofSeed(job).artifacts.filter((file) => file.role === role && (step === undefined || file.step === step));
  // One without a step was made at the job's end.
  return found.reduce((best, file) => (!best || (file.step ?? Infinity) >= (best.step ?? Infinity) ? file : best), null);
}

/** The last return that the job reported, or null. */
export function lastReturn(job) {
  for (const name of RETURNS) if (typeof job.progress.metrics[name] === "number") return job.progress.metrics[name];
  return null;
}

/** What the cluster calls the allocation that a worker runs in: `Slurm job 4711 on n1, account vnl`. */
export function allocated({ scheduler, id, node, account }) {
  const name = scheduler === "slurm" ? "Slurm" : scheduler;
  return `${name} job ${id}${node ? ` on ${node}` : ""}${account ? `, account ${account}` : ""}`;
}

/** @param {object[]} workers All of them. */
export function whyQueued(job, workers) {
  if (job.waiting_for) return job.waiting_for;
  if (job.not_before && new Date(job.not_before) > Date.now()) return `The attempt before failed; it is tried again at ${moment(job.not_before)}.`;
  if (!workers.length) return "No worker is running.";
  if (job.turn) return job.turn.reason;
  return workers.every((worker) => worker.job) ? "Every worker that could run it is busy." : "Jobs before it come first.";
}

/**
 * @returns {Promise<{path: string, value: any, origin: "sent" | "filled in"}[]>} Every setting.
 */
export async function settingsOf(job) {
  const isSent = new Set(flat(sentBy(job)).map(([path]) => path));
  return flat(await get(job.links.specification)).map(([path, value]) => ({
    path,
    value,
    origin: isSent.has(path) ? "sent" : "filled in",
  }));
}

const sentBy = (job) => ({ ...job.spec, environment: { id: environmentOf(job.spec), options: optionsOf(job.spec) } });

/** A document as pairs of a path and a value; lists are values. */
function flat(document, path = []) {
  if (document === null || typeof document !== "object" || Array.isArray(document) || !Object.keys(document).length) {
    return [[path.join("."), document]];
  }
  return Object.entries(document).flatMap(([name, value]) => flat(value, [...path, name]));
}
