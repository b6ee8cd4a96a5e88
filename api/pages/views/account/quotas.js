/** What users and projects may have: set, changed and removed by admins. */

import { get, remove, send } from "../../lib/api.js";
import { useSubmission } from "../../lib/draft.js";
import { html, useState } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { Confirm, Failure, Loading } from "../../parts/elements.js";
import { Quotas as Table } from "../../parts/quotas.js";

const FIELDS = { weight: "Weight", running: "Running", queued: "Waiting", gpu_hours: "GPU hours in 7 days", gigabytes: "Stored, in GB" };
const PRIORITIES = ["high", "normal", "low"];
const EMPTY = { weight: "1", running: "", queued: "", gpu_hours: "", gigabytes: "", highest_priority: "high" };
const load = (signal) => Promise.all(["/quotas", "/projects", "/users"].map((path) => get(path, {}, { signal })));

export function Quotas() {
  const { data, error, again } = useLive(load, []);
  const [draft, setDraft] = useState({ ...EMPTY, whose: "" });
  if (!data) return error ? html`<${Failure} error=${error} again=${again} />` : html`<${Loading} what="quotas" />`;
  const [quotas, projects, users] = data.map(({ items }) => items);
  const parties = { Projects: projects.map(({ name }) => `project ${name}`), Users: users.map(({ name }) => `user ${name}`) };
  const choose = (whose) => setDraft({ ...textOf(quotas.find((one) => `${one.kind} ${one.name}` === whose)), whose });
  const Do = ({ quota }) => html`<${Actions} quota=${quota} choose=${choose} again=${again} />`;
  return html`
    <${Form} draft=${draft} setDraft=${setDraft} parties=${parties} choose=${choose} onSet=${again} />
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!quotas.length && html`<p class="facts">No quota is set: everybody may have as much as they like.</p>`}
    ${quotas.length > 0 && html`<section class="card"><${Table} items=${quotas} Do=${Do} /></section>`}`;
}

function Actions({ quota, choose, again }) {
  const [problem, setProblem] = useState(null);
  const whose = `${quota.kind} ${quota.name}`;
  const discard = () => remove(pathOf(whose)).then(again, setProblem);
  return html`<span class="actions">
    <button type="button" aria-label="Change the quota of ${whose}" onClick=${() => choose(whose)}>Change</button>
    <${Confirm} text="Remove" question="Let the ${whose} have as much as they like?" onYes=${discard} isDangerous />
    ${problem && html`<span class="error" role="alert">${problem.message}</span>`}
  </span>`;
}

function Form({ draft, setDraft, parties, choose, onSet }) {
  const set = (name) => ({ target }) => setDraft((before) => ({ ...before, [name]: target.value }));
  const { problem, isBusy, reset, submit } = useSubmission(async () => {
    await send(pathOf(draft.whose), { method: "PUT", body: JSON.stringify(documentOf(draft)), type: "application/json" });
    setDraft({ ...EMPTY, whose: "" });
    reset();
    onSet();
  }, draft);
  return html`<form class="card stack" onSubmit=${submit} novalidate aria-label="Set a quota">
    <h2>Set a quota</h2>
    <p class="facts">An empty field is no limit, and 0 is none at all.</p>
    <div class="tools">
      <label>Of <select value=${draft.whose} onChange=${({ target }) => choose(target.value)}>
        <option value="">choose</option>
        ${Object.entries(parties).map(([title, names]) => html`<optgroup key=${title} label=${title}>${names.map((whose) => html`<option key=${whose} value=${whose}>${whose}</option>`)}</optgroup>`)}
      </select></label>
      ${Object.entries(FIELDS).map(([name, title]) => html`<label key=${name}>${title} <input inputmode="decimal" size="8" value=${draft[name]} onInput=${set(name)} /></label>`)}
      <label>Highest priority <select value=${draft.highest_priority} onChange=${set("highest_priority")}>
        ${PRIORITIES.map((priority) => html`<option key=${priority} value=${priority}>${priority}</option>`)}
      </select></label>
      <button class="main" disabled=${isBusy || !draft.whose}>Set it</button>
    </div>
    ${problem && html`<p class="error" role="alert">${problem.message}</p>`}
  </form>`;
}

const pathOf = (whose) => `/quotas/${whose.split(" ").map(encodeURIComponent).join("/")}`;

/** The fields of a quota; of none, those of no limits. */
function textOf(quota) {
  if (!quota) return EMPTY;
  const shown = { ...quota, gigabytes: quota.bytes === null ? null : quota.bytes / 1e9 };
  return Object.fromEntries(Object.keys(EMPTY).map((name) => [name, shown[name] === null ? "" : String(shown[name])]));
}

/** What is no number goes as text, which the service refuses with the field's name. */
function documentOf({ weight, running, queued, gpu_hours, gigabytes, highest_priority }) {
  const number = (text) => (Number.isFinite(Number(text)) ? Number(text) : text);
  const limit = (text) => (text.trim() ? number(text) : null);
  const stored = limit(gigabytes);
  return {
    weight: weight.trim() ? number(weight) : 1,
    running: limit(running),
    queued: limit(queued),
    gpu_hours: limit(gpu_hours),
    bytes: typeof stored === "number" ? Math.round(stored * 1e9) : stored,
    highest_priority,
  };
}
