/** How the settings of the next trial are chosen, and when to stop. */

import { html } from "../../lib/html.js";
import { Field } from "../../parts/field.js";
import { Prose } from "../../parts/prose.js";

const METHODS = {
  grid: "Every combination; the last axis changes first.",
  random: "Independent draws. Needs a limit of jobs, steps or GPU hours.",
  qmc: "Draws that spread more evenly (Sobol's sequence). Needs a limit.",
  tpe: "Each draw depends on the results so far (Optuna's tree-structured Parzen estimator). Needs a limit.",
  cma_es: "Generations move towards better values of two or more ranges (Optuna's CMA-ES); one objective, no lists. Needs a limit.",
  nsga2: "Generations cross the settings that none beats, for several objectives (Optuna's NSGA-II). Needs a limit.",
  pbt: "A population trains side by side; after each generation the worst resume from the best (population-based training).",
};

export function MethodPart(fields) {
  const { all, document, set, errors } = fields;
  const { method } = document;
  const schema = all.SweepSpec.properties;
  const wrong = errors.filter(({ pointer }) => pointer === "/method");
  return html`
    <fieldset class="part"><legend>Method</legend>
      <div class="choices">${Object.entries(METHODS).map(
        ([name, text]) => html`<label key=${name} class="tick"><input type="radio" name="method" value=${name} checked=${name === method} onChange=${() => set(["method"], name)} />
          <span><strong>${name}</strong> <span class="facts">${text}</span></span></label>`,
      )}</div>
      ${wrong.map(({ detail }) => html`<p class="error"><${Prose} text=${detail} /></p>`)}
      ${method === "pbt" && html`<fieldset><legend>Population</legend><${Field} ...${fields} path=${["population"]} schema=${{ $ref: "Population" }} isOpen /></fieldset>`}
      ${method !== "grid" && html`<div class="fields"><${Field} ...${fields} path=${["seed"]} schema=${schema.seed} /></div>`}
    </fieldset>
    <fieldset><legend>Budget</legend>
      <${Field} ...${fields} path=${["budget"]} schema=${{ $ref: "Budget" }} isOpen />
    </fieldset>
    ${method !== "pbt" && document.job.kind !== "rollout" && html`<fieldset><legend>Pruning</legend>
      <${Field} ...${fields} path=${["pruning"]} schema=${schema.pruning} none="none: every trial runs to its end" />
    </fieldset>`}
  `;
}
