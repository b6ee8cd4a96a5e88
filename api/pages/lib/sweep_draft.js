/** A sweep that is being written: what the form holds, and the document that is sent. */

import { get } from "./api.js";
import { fromAddress, jobOf, parsed } from "./draft.js";
import { title } from "./job.js";
import { openapi } from "./schemas.js";

/** What only some methods take; the form keeps it meanwhile. */
const TAKEN = {
  grid: ["pruning"],
  random: ["pruning", "seed"],
  qmc: ["pruning", "seed"],
  tpe: ["pruning", "seed"],
  cma_es: ["pruning", "seed"],
  nsga2: ["pruning", "seed"],
  pbt: ["population", "seed"],
};
/** These compare trials by one objective. */
export const WITH_ONE_OBJECTIVE = ["cma_es", "pbt"];
const EMPTY = { method: "grid", parameters: {}, objectives: [{}] };
// A trial's own; a sweep over such a job gives others.
const OF_TRIALS = ["sweep", "trial"];

/** The draft that an address asks for: a sweep `again`, a `job` as JSON, one to begin `from`, or an `environment`. Raises an Error. */
export async function draftFrom(query) {
  if (query.get("again")) {
    const { note, ...spec } = (await get(`/sweeps/${encodeURIComponent(query.get("again"))}`)).spec; // It is about that sweep.
    return draftOf(spec);
  }
  const written = query.get("job");
  if (written) return readDraft(written, EMPTY);
  const job = await fromAddress(query);
  return { ...EMPTY, job: asWritten(job), ...(query.get("from") && { name: `${title({ name: job.name, kind: job.kind, spec: job })}, swept` }) };
}

/** The job as the form writes it. */
export function asWritten({ labels, ...job }) {
  const own = Object.fromEntries(Object.entries(labels || {}).filter(([name]) => !OF_TRIALS.includes(name)));
  return jobOf({ ...job, ...(Object.keys(own).length && { labels: own }) });
}

/** The draft of a document as `POST /sweeps` takes it, or `GET /sweeps/{id}` shows it. */
export function draftOf(document) {
  const { objective, budget, ...said } = withoutNulls(document);
  return {
    method: "random",
    ...said,
    ...(budget && { budget: withoutNulls(budget) }),
    parameters: Object.fromEntries(Object.entries(document.parameters || {}).map(([path, axis]) => [path, Array.isArray(axis) ? axis : withoutNulls(axis)])),
    job: asWritten(document.job),
    objectives: [objective ?? {}].flat(),
  };
}

const withoutNulls = (document) => Object.fromEntries(Object.entries(document).filter(([, value]) => value !== null));

/** The document to send. */
export function documentOf({ name, labels, project, job, method, parameters, objectives, budget, ...others }) {
  const wanted = objectives.slice(0, WITH_ONE_OBJECTIVE.includes(method) ? 1 : undefined);
  const [first] = wanted;
  return {
    ...(name !== undefined && { name }),
    ...(labels !== undefined && { labels }),
    ...(project !== undefined && { project }),
    job,
    method,
    parameters: Object.fromEntries(Object.entries(parameters).map(([path, axis]) => [path, axisOf(axis, method)])),
    ...(wanted.length > 1 ? { objective: wanted } : Object.keys(first).length > 0 && { objective: first }),
    ...(budget !== undefined && { budget }),
    ...Object.fromEntries(TAKEN[method].filter((part) => others[part] !== undefined).map((part) => [part, others[part]])),
  };
}

/** Only grids have points; whether an axis may have them, the service says. */
function axisOf(axis, method) {
  if (Array.isArray(axis) || method === "grid") return axis;
  const { points, ...range } = axis;
  return range;
}

/** What text stands for: a job, or a whole sweep, as JSON. Raises an Error with a sentence. */
export function readDraft(text, before) {
  const found = parsed(text);
  const isSweep = typeof found?.job === "object" && found.job !== null;
  const job = isSweep ? found.job : found;
  if (!job?.environment) throw new Error("This is neither a job nor a sweep: a job has an `environment`, and a sweep a `job`.");
  return isSweep ? draftOf(found) : { ...before, job: asWritten(job) };
}

/** The examples of sweeps in the service's OpenAPI document: {name: document}. */
export async function examples() {
  const { paths } = await openapi();
  const { examples: found } = paths["/sweeps"].post.requestBody.content["application/json"];
  return Object.fromEntries(Object.entries(found).map(([name, { value }]) => [name, value]));
}
