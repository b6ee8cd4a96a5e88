/** A new sweep's method, objectives and size. */

import { html } from "../../lib/html.js";
import { WITH_ONE_OBJECTIVE } from "../../lib/sweep_draft.js";
import { MOST_TRIALS, sizeOf } from "../../lib/sweep_size.js";
import { Prose } from "../../parts/elements.js";
import { Field } from "../../parts/field.js";

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

const MOST = 4;

export function Objectives({ all, document, set, errors, environment }) {
  const { objectives, method, job } = document;
  const takesOne = WITH_ONE_OBJECTIVE.includes(method);
  const isAlone = objectives.length === 1 || takesOne;
  const shown = takesOne ? objectives.slice(0, 1) : objectives;
  const metrics = environment?.metrics?.[job.kind === "rollout" ? "rollout" : job.algorithm?.kind || "ppo"] || [];
  const { metric, direction } = all.Objective.properties;
  // The service names a single objective without a number.
  const here = errors.map((error) => ({ ...error, pointer: error.pointer.replace(isAlone ? /^\/objective(?=\/)/ : /^\/objective(?=\/\d)/, isAlone ? "/objectives/0" : "/objectives") }));
  const remove = (at) => set(["objectives"], objectives.filter((_, i) => i !== at));
  return html`<fieldset class="part"><legend>Objective</legend>
    ${errors.filter(({ pointer }) => pointer === "/objective").map(({ detail }) => html`<p class="error"><${Prose} text=${detail} /></p>`)}
    ${shown.map((objective, i) => {
      const put = ([, , name], value) => set(["objectives"], objectives.map((one, at) => (at === i ? withPart(one, name, value) : one)));
      const fields = { all, document: { objectives }, set: put, errors: here };
      return html`<div class="fields" key=${i} role="group" aria-label="Objective ${i + 1}">
        <${Field} ...${fields} path=${["objectives", i, "metric"]} schema=${{ ...metric, description: "Its last value counts." }} suggestions=${metrics} />
        <${Field} ...${fields} path=${["objectives", i, "direction"]} schema=${direction} />
        ${!isAlone && html`<p class="actions"><button type="button" aria-label="Remove objective ${i + 1}" onClick=${() => remove(i)}>Remove</button></p>`}
      </div>`;
    })}
    ${!takesOne && objectives.length < MOST && html`<p class="actions"><button type="button" onClick=${() => set(["objectives"], [...objectives, {}])}>Add another objective</button></p>`}
    ${!isAlone && html`<p class="facts">The best trials are those that none beats in every objective. Pruning needs a single one.</p>`}
  </fieldset>`;
}

function withPart(objective, name, value) {
  const { [name]: before, ...rest } = objective;
  return value === undefined ? rest : { ...rest, [name]: value };
}

const UNKNOWN = {
  grid: "How many trials it has is known once each axis has its values.",
  pbt: "How many trials it has is known once the population has generations.",
};
const BY_BUDGET = "How many trials it has depends on the budget.";

export function Size({ document, known, environment }) {
  const { trials, each, dependsOnDevice, steps, isMost } = sizeOf(document, known, environment);
  const parallel = document.budget?.parallel ?? 4;
  return html`<section class="card" aria-label="Size" role="status"><h2>${trials === null ? "Size" : `${number(trials)} trial${trials === 1 ? "" : "s"}`}</h2>
    ${trials === null && html`<p class="facts">${UNKNOWN[document.method] ?? BY_BUDGET}</p>`}
    ${trials > MOST_TRIALS && html`<p class="error">A sweep has ${number(MOST_TRIALS)} trials at most: take fewer values, or random draws.</p>`}
    <ul class="facts">
      ${each !== null && html`<li>${dependsOnDevice ? "up to " : ""}${number(each)} environment steps each${dependsOnDevice ? ", depending on the device" : ""}</li>`}
      ${steps !== null && html`<li>${number(Math.round(steps))} steps in all${isMost ? ", at most" : ""}</li>`}
      ${trials !== null && html`<li>${number(Math.min(parallel, trials))} at the same time</li>`}
    </ul>
  </section>`;
}

const number = (value) => value.toLocaleString("en");
