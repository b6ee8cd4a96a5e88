/** The environment and its options. */

import { html } from "../../lib/html.js";
import { Field } from "../../parts/field.js";
import { Prose } from "../../parts/prose.js";
import { Failure } from "../../parts/states.js";
import { OwnModels } from "./models.js";

export function EnvironmentPart({ all, document, set, errors, environments, environment, problem }) {
  const families = byFamily(environments);
  const wrong = errors.filter(({ pointer }) => ["/environment", "/environment/id"].includes(pointer));
  const { id, options: { model } = {} } = document.environment;
  const choose = (event) => set(["environment"], { id: event.target.value });
  const options = environment?.options;
  // References in an environment's own schema lead into that schema.
  const here = { ...all, ...(options?.$defs || {}) };
  return html`<fieldset><legend>Environment</legend>
    <div class="field wide">
      <label for="environment">Environment</label>
      <select id="environment" value=${id} onChange=${choose} aria-invalid=${wrong.length ? "true" : undefined}>
        ${[...families].map(([family, rows]) => html`<optgroup label=${family}>${rows.map((row) => html`<option value=${row.id}>${row.id}</option>`)}</optgroup>`)}
      </select>
      <p class="facts"><${Prose} text=${environment?.description || ""} /></p>
      ${id === "mjcf" && html`<${OwnModels} chosen=${model} choose=${(one) => set(["environment", "options", "model"], one)} />`}
      ${wrong.map(({ detail }) => html`<p class="error"><${Prose} text=${detail} /></p>`)}
      ${problem && html`<${Failure} error=${problem} />`}
    </div>
    ${options && Object.keys(options.properties || {}).length > 0 &&
    html`<${Field} all=${here} document=${document} set=${set} errors=${errors} path=${["environment", "options"]} schema=${options} planned=${{}} />`}
  </fieldset>`;
}

function byFamily(environments) {
  const found = new Map();
  for (const one of environments) found.set(one.family, [...(found.get(one.family) || []), one]);
  return found;
}
