/** What the trials are judged by: one metric, or up to four. */

import { html } from "../../lib/html.js";
import { WITH_ONE_OBJECTIVE } from "../../lib/sweep_draft.js";
import { Field } from "../../parts/field.js";
import { Prose } from "../../parts/prose.js";

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
