/** The forms that add a webhook and change one. */

import { patch, post } from "../../lib/api.js";
import { useSubmission } from "../../lib/draft.js";
import { html, useState } from "../../lib/html.js";
import { Confirm, Copy, Prose } from "../../parts/elements.js";

const EVENTS = {
  "job.succeeded": "a job has succeeded",
  "job.failed": "a job has failed",
  "job.cancelled": "a job was cancelled",
  "job.started": "a job has started",
  "job.attempt_lost": "an attempt was lost, and another one follows",
  "sweep.succeeded": "a sweep has succeeded",
  "sweep.failed": "a sweep has failed",
  "sweep.cancelled": "a sweep was cancelled",
};
const BY_DEFAULT = Object.keys(EVENTS).filter((name) => !["job.started", "job.attempt_lost"].includes(name));
const JOBS = { all: "all of the project", own: "its owner’s own", named: "those that name it in notify" };

/** path: of the project's webhooks. onMade: called once one is there. */
export function NewWebhook({ path, onMade }) {
  const [draft, setDraft] = useState({ name: "", url: "", events: BY_DEFAULT, jobs: "all" });
  const [made, setMade] = useState(null);
  const { problem, isBusy, reset, submit } = useSubmission(async () => {
    setMade(await post(path, draft));
    setDraft((before) => ({ ...before, name: "", url: "" }));
    reset();
    onMade();
  }, draft);
  return html`<form class="card stack" onSubmit=${submit} novalidate aria-label="Add a webhook">
    <h2>Add a webhook</h2>
    <${Fields} draft=${draft} setDraft=${setDraft} isNew hint="https://… or slack://…" />
    <p><button class="main" disabled=${isBusy || !draft.name || !draft.url}>Add it</button></p>
    ${problem && html`<p class="error" role="alert"><${Prose} text=${problem.message} /></p>`}
    ${made && html`<${Told} made=${made} text="${made.name} is told." />`}
  </form>`;
}

/** path: its own. onChanged: called after each change; onDone: it needs no more. */
export function ChangeWebhook({ webhook, path, onChanged, onDone }) {
  const [draft, setDraft] = useState({ url: "", events: webhook.events, jobs: webhook.jobs });
  const [made, setMade] = useState(null);
  const { problem, setProblem, isBusy, submit } = useSubmission(async () => {
    await patch(path, { ...draft, url: draft.url || undefined });
    onChanged();
    onDone();
  }, draft);
  const attempt = (sent, then) => (setProblem(null), sent.then(then).catch(setProblem));
  const turn = () => attempt(patch(path, { active: Boolean(webhook.stopped) }), onChanged);
  const rotate = () => attempt(post(`${path}/rotate`), setMade);
  return html`<form class="card stack" onSubmit=${submit} novalidate aria-label="Change ${webhook.name}">
    <h2 tabindex="-1" ref=${focusOnce}>Change ${webhook.name}</h2>
    <${Fields} draft=${draft} setDraft=${setDraft} hint=${webhook.url} />
    <p class="facts">Without an address it keeps its own. What waits for a stopped webhook ends.</p>
    <p class="actions"><button class="main" disabled=${isBusy}>Change it</button>
      <button type="button" onClick=${turn}>${webhook.stopped ? "Start it" : "Stop it"}</button>
      ${webhook.url.startsWith("http") && html`<${Confirm} text="Make a new secret" question="The old secret signs beside the new one for a day." onYes=${rotate} />`}
      <button type="button" onClick=${onDone}>Close</button></p>
    ${problem && html`<p class="error" role="alert"><${Prose} text=${problem.message} /></p>`}
    ${made && html`<${Told} made=${made} text="${made.name} has a new secret; the old one signs beside it for a day." />`}
  </form>`;
}

const seen = new WeakSet();

/** A heading that has just come; not again when it is drawn anew. */
function focusOnce(heading) {
  if (!heading || seen.has(heading)) return;
  seen.add(heading);
  heading.focus();
}

/** hint: what stands in an empty address. */
function Fields({ draft, setDraft, isNew, hint }) {
  const set = (name) => ({ target }) => setDraft((before) => ({ ...before, [name]: target.value }));
  const toggle = (event) => ({ target }) =>
    setDraft((before) => ({ ...before, events: Object.keys(EVENTS).filter((one) => (one === event ? target.checked : before.events.includes(one))) }));
  return html`<div class="tools">
      ${isNew && html`<label>Name <input value=${draft.name} onInput=${set("name")} autocapitalize="off" placeholder="lab-chat" /></label>`}
      <label class="long">Address <input value=${draft.url} onInput=${set("url")} autocapitalize="off" placeholder=${hint} /></label>
      <label>Of jobs <select value=${draft.jobs} onChange=${set("jobs")}>${Object.entries(JOBS).map(([name, text]) => html`<option key=${name} value=${name}>${text}</option>`)}</select></label>
    </div>
    <fieldset class="tools"><legend>When</legend>
      ${Object.entries(EVENTS).map(([name, text]) => html`<label class="inline" key=${name}><input type="checkbox" checked=${draft.events.includes(name)} onChange=${toggle(name)} /> ${text}</label>`)}
    </fieldset>`;
}

function Told({ made, text }) {
  if (!made.secret) return html`<p role="status">${text}</p>`;
  return html`<div role="status" class="stack secret">
    <p>${text} Its messages are signed by this secret. <strong>It is shown this once</strong>: copy it now, to the receiver.</p>
    <${Copy} text=${made.secret} name="The secret" />
  </div>`;
}
