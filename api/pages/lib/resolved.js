/** A job's specification with everything that it left out: as it was sent, tuned, or by default. */

import { get } from "./api.js";
import { environmentOf, hyperparametersOf, optionsOf } from "./job.js";
import { filled, flat, schemas } from "./schemas.js";

/**
 * @returns {Promise<{path: string, value: any, origin: "sent" | "filled in"}[]>} Every setting.
 */
export async function settingsOf(job) {
  const all = await schemas();
  const options = optionsOf(job.spec);
  const query = Object.keys(options).length ? { options: JSON.stringify(options) } : {};
  const environment = await get(`/environments/${environmentOf(job.spec)}`, query).catch(() => null);
  const isSent = new Set(flat(sentBy(job)).map(([path]) => path));
  return flat(whole(job, all, environment)).map(([path, value]) => ({
    path,
    value,
    origin: isSent.has(path) ? "sent" : "filled in",
  }));
}

const sentBy = (job) => ({ ...job.spec, environment: { id: environmentOf(job.spec), options: optionsOf(job.spec) } });

function whole(job, all, environment) {
  const spec = filled(all[job.kind === "train" ? "TrainSpec" : "RolloutSpec"], all, job.spec);
  const options = environment ? filled(environment.options, environment.options.$defs || {}, optionsOf(job.spec)) : optionsOf(job.spec);
  const found = { ...spec, environment: { id: environmentOf(job.spec), options } };
  if (job.kind === "train") found.algorithm = algorithmOf(job, environment);
  return found;
}

/** What the newest attempt ran with; before there is one, what it would run with on a CPU. */
function algorithmOf(job, environment) {
  const sent = { kind: "ppo", ...job.spec.algorithm };
  const device = job.spec.resources?.accelerator === "gpu" ? "gpu" : "cpu";
  const planned = environment?.defaults?.[sent.kind]?.[device] || {};
  const ran = hyperparametersOf(job);
  return Object.keys(ran).length ? ran : { ...planned, ...sent };
}
