/** The axes of a sweep: which settings vary. */

import { html, useRef, useState } from "../../lib/html.js";
import { choicesOf, isNumeric, kindOf } from "../../lib/schemas.js";
import { told } from "../../lib/sweep.js";
import { Prose } from "../../parts/elements.js";
import { Axis } from "./axis.js";

const LENGTH = "algorithm.num_timesteps";
const GROUPS = { "algorithm.": "Algorithm", "environment.options.": "Environment", "policy.": "Policy", "": "Everything else" };

export function Axes({ draft, setDraft, errors, known, environment }) {
  const [added, setAdded] = useState(null);
  const adder = useRef();
  const { parameters, method } = draft;
  const change = (next) => setDraft((before) => ({ ...before, parameters: next(before.parameters) }));
  const add = (path) => {
    setAdded(path);
    change((before) => ({ ...before, [path]: begun(known.find((field) => field.path === path), method) }));
  };
  const remove = (path) => {
    change(({ [path]: gone, ...rest }) => rest);
    adder.current?.focus();
  };
  const here = errors.filter(({ pointer }) => pointer === "/parameters");
  return html`<fieldset class="part"><legend>Axes</legend>
    ${!Object.keys(parameters).length && html`<p class="facts">Nothing varies yet: add a setting of the job.</p>`}
    ${here.map(({ detail }) => html`<p class="error"><${Prose} text=${detail} /></p>`)}
    <div class="stack">
      ${Object.entries(parameters).map(
        ([path, axis]) => html`<${Axis} key=${path} path=${path} axis=${axis} method=${method} errors=${errors} isNew=${path === added}
          field=${known.find((field) => field.path === path)} isKnown=${!environment || known.some((field) => field.path === path)}
          set=${(value) => change((before) => ({ ...before, [path]: value }))} remove=${() => remove(path)} />`,
      )}
      <${Add} select=${adder} fields=${known.filter(({ path }) => !(path in parameters) && suits(path, method))} environment=${environment} job=${draft.job} add=${add} />
    </div>
  </fieldset>`;
}

/** A population varies settings of the algorithm alone. */
const suits = (path, method) => method !== "pbt" || (path.startsWith("algorithm.") && path !== LENGTH);

/** An axis without values yet; of a few choices, all. */
const begun = (field, method) => choicesOf(field) || (isNumeric(field) && method !== "grid" ? {} : []);

function Add({ select, fields, environment, job, add }) {
  const [path, setPath] = useState("");
  const isThere = fields.some((field) => field.path === path);
  const take = () => (add(path), setPath(""));
  return html`<div class="adder">
    <div class="field"><label for="setting">Setting</label><select id="setting" ref=${select} value=${isThere ? path : ""} onChange=${({ target }) => setPath(target.value)}>
      <option value="">Choose a setting</option>
      ${Object.entries(grouped(fields, environment, job)).map(
        ([group, found]) => html`<optgroup key=${group} label=${GROUPS[group]}>
          ${found.map((field) => html`<option key=${field.path} value=${field.path}>${field.path.slice(group.length)} (${kindOf(field)}${now(field)})</option>`)}
        </optgroup>`,
      )}
    </select></div>
    <button type="button" disabled=${!isThere} onClick=${take}>Add the axis</button>
  </div>`;
}

function now({ now: value }) {
  const text = value === undefined || value === null ? "" : told(value);
  return text && text.length <= 24 ? `, now ${text}` : "";
}

/** The fields by their place; of the algorithm, those first that are tuned for the environment. */
function grouped(fields, environment, job) {
  const tuned = new Set(["learning_rate", ...Object.values(environment?.tuned?.[job.algorithm?.kind || "ppo"] || {}).flatMap(Object.keys)]);
  const found = {};
  for (const group of Object.keys(GROUPS)) {
    const own = fields.filter(({ path }) => Object.keys(GROUPS).find((prefix) => path.startsWith(prefix)) === group);
    const rank = ({ path }) => Number(!tuned.has(path.slice(group.length)));
    if (own.length) found[group] = group === "algorithm." ? [...own].sort((one, other) => rank(one) - rank(other)) : own;
  }
  return found;
}
