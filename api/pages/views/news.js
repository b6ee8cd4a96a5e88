/** Who is told of a project's jobs: webhooks, made with a secret that is shown once; what was sent to each. */

import { get, post, remove } from "../lib/api.js";
import { useSubmission } from "../lib/draft.js";
import { html, useState } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { change, href } from "../lib/route.js";
import { isAdmin, maySubmit, session } from "../lib/session.js";
import { Deliveries } from "../parts/deliveries.js";
import { Confirm, Copy, Failure, Loading, Pages, Prose } from "../parts/elements.js";
import { useProjects } from "../parts/whose.js";

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
const JOBS = { all: "all of the project", own: "your own", named: "those that name it in notify" };
const EVERY_MS = 3000;

/** The query's `project`, and `webhook`: whose deliveries are shown. */
export default function News({ query }) {
  const projects = useProjects();
  const project = query.get("project") || projects[0] || "default";
  const path = `/projects/${encodeURIComponent(project)}/webhooks`;
  const { data, error, again } = useLive((signal) => get(path, {}, { signal }), [path]);
  const chosen = query.get("webhook");
  return html`<div class="stack">
    <h1>News</h1>
    ${projects.length > 1 && html`<div class="tools"><label>Project
      <select value=${project} onChange=${({ target }) => change({ project: target.value, webhook: [], cursor: [] })}>${projects.map((name) => html`<option key=${name} value=${name}>${name}</option>`)}</select>
    </label></div>`}
    ${maySubmit() && html`<${NewWebhook} key=${path} path=${path} onMade=${again} />`}
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data && !error && html`<${Loading} what="webhooks" />`}
    ${data && !data.items.length && html`<p class="facts">Nobody is told of the jobs of ${project} yet.</p>`}
    ${data?.items.length > 0 && html`<div class="card table stacking" tabindex="0" role="region" aria-label="Webhooks"><table>
      <thead><tr><th>Webhook</th><th>Address</th><th>Is told</th><th>Of jobs</th><th>Owner</th><th>Do</th></tr></thead>
      <tbody>${data.items.map((webhook) => html`<${Row} key=${webhook.name} webhook=${webhook} path=${path} again=${again} />`)}</tbody>
    </table></div>`}
    ${chosen && data?.items.some(({ name }) => name === chosen) && html`<${Sent} key=${`${path} ${chosen}`} name=${chosen} path=${path} query=${query} />`}
  </div>`;
}

function Row({ webhook, path, again }) {
  const [problem, setProblem] = useState(null);
  const own = `${path}/${encodeURIComponent(webhook.name)}`;
  const show = () => change({ project: webhook.project, webhook: webhook.name, cursor: [] });
  const test = () => post(`${own}/test`).then(show, setProblem);
  const discard = () => remove(own).then(again, setProblem);
  const mayChange = !session().accounts || isAdmin() || (maySubmit() && webhook.owner === session().who.user);
  return html`<tr>
    <td data-label="Webhook"><a href=${href(["news"], { project: webhook.project, webhook: webhook.name })} title="What was sent to it">${webhook.name}</a></td>
    <td data-label="Address"><code>${webhook.url}</code></td>
    <td data-label="Is told">${webhook.events.join(", ")}</td>
    <td data-label="Of jobs">${webhook.jobs}</td>
    <td data-label="Owner">${webhook.owner || "–"}</td>
    <td data-label="Do"><span>
      ${webhook.stopped && html`<span class="facts">${webhook.stopped}</span>`}
      ${mayChange && html`<span class="actions"><button type="button" onClick=${test} aria-label="Test ${webhook.name}">Test</button>
        <${Confirm} text="Delete" question="Nothing more is sent to ${webhook.name}. Delete it?" onYes=${discard} isDangerous /></span>`}
      ${problem && html`<span class="error" role="alert">${problem.message}</span>`}
    </span></td>
  </tr>`;
}

function Sent({ name, path, query }) {
  const cursor = query.get("cursor");
  const load = (signal) => get(`${path}/${encodeURIComponent(name)}/deliveries`, { cursor }, { signal });
  const { data, error, again } = useLive(load, [cursor], EVERY_MS);
  return html`<section class="card stack">
    <h2>Sent to ${name} in the last week</h2>
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${data && !data.items.length && html`<p class="facts">Nothing yet.</p>`}
    ${data?.items.length > 0 && html`<${Deliveries} items=${data.items} what="job" />`}
    ${data && html`<${Pages} path=${["news"]} query=${query} next=${data.next} name="Pages of deliveries" first="Newest" more="Older ones" />`}
  </section>`;
}

function NewWebhook({ path, onMade }) {
  const [draft, setDraft] = useState({ name: "", url: "", events: BY_DEFAULT, jobs: "all" });
  const [made, setMade] = useState(null);
  const set = (name) => ({ target }) => setDraft((before) => ({ ...before, [name]: target.value }));
  const toggle = (event) => ({ target }) =>
    setDraft((before) => ({ ...before, events: Object.keys(EVENTS).filter((one) => (one === event ? target.checked : before.events.includes(one))) }));
  const { problem, isBusy, reset, submit } = useSubmission(async () => {
    setMade(await post(path, draft));
    setDraft((before) => ({ ...before, name: "", url: "" }));
    reset();
    onMade();
  }, draft);
  return html`<form class="card stack" onSubmit=${submit} novalidate aria-label="Add a webhook">
    <h2>Add a webhook</h2>
    <div class="tools">
      <label>Name <input value=${draft.name} onInput=${set("name")} autocapitalize="off" placeholder="lab-chat" /></label>
      <label>Address <input value=${draft.url} onInput=${set("url")} autocapitalize="off" placeholder="https://… or slack://…" /></label>
      <label>Of jobs <select value=${draft.jobs} onChange=${set("jobs")}>${Object.entries(JOBS).map(([name, text]) => html`<option key=${name} value=${name}>${text}</option>`)}</select></label>
    </div>
    <fieldset class="tools"><legend>When</legend>
      ${Object.entries(EVENTS).map(([name, text]) => html`<label class="inline" key=${name}><input type="checkbox" checked=${draft.events.includes(name)} onChange=${toggle(name)} /> ${text}</label>`)}
    </fieldset>
    <p><button class="main" disabled=${isBusy || !draft.name || !draft.url}>Add it</button></p>
    ${problem && html`<p class="error" role="alert"><${Prose} text=${problem.message} /></p>`}
    ${made?.secret && html`<div role="status" class="stack secret">
      <p>${made.name} is told. Its messages are signed by this secret. <strong>It is shown this once</strong>: copy it now, to the receiver.</p>
      <${Copy} text=${made.secret} name="The secret" />
    </div>`}
    ${made && !made.secret && html`<p role="status">${made.name} is told.</p>`}
  </form>`;
}
