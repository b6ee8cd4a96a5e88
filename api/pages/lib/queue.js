/** Why a queued job waits. */

import { moment } from "./format.js";

/** @param {object[]} workers All of them. */
export function whyQueued(job, workers) {
  if (job.waiting_for) return job.waiting_for;
  if (job.not_before && new Date(job.not_before) > Date.now()) return `The attempt before failed; it is tried again at ${moment(job.not_before)}.`;
  if (!workers.length) return "No worker is running.";
  return workers.every((worker) => worker.job) ? "Every worker that could run it is busy." : "Jobs before it come first.";
}
