/** A job's specification with everything that it left out, as the service fills it in. */

import { get } from "./api.js";
import { environmentOf, optionsOf } from "./job.js";

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
