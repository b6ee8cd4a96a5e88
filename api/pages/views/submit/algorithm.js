/** The algorithm and its hyperparameters, with the values that are tuned for the environment. */

import { html } from "../../lib/html.js";
import { Field } from "../../parts/field.js";

export function AlgorithmPart({ schema, environment, document, ...fields }) {
  const device = document.resources?.accelerator === "gpu" || document.resources?.gpus > 1 ? "gpu" : "cpu";
  const plannedFields = (kind) => environment?.defaults?.[kind]?.[device];
  // What is tuned for a body is what people change first.
  const firstFields = (kind) => [...new Set(["num_timesteps", "learning_rate", ...Object.keys(environment?.tuned?.[kind]?.[device] || {})])];
  const kind = document.algorithm?.kind || "ppo";
  return html`<fieldset><legend>Algorithm</legend>
    ${environment && !plannedFields(kind) && html`<p class="facts">On this environment, ${kind} needs more than its defaults.</p>`}
    <${Field} ...${fields} document=${document} path=${["algorithm"]} schema=${schema} planned=${{ kind: "ppo" }} plannedFields=${plannedFields} firstFields=${firstFields} />
    <p class="facts">Grey values are those that a job on a ${device.toUpperCase()} takes here.</p>
  </fieldset>`;
}
