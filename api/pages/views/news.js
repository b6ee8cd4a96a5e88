/** Who is told of a project's jobs: its webhooks, and what was sent to each. */

import { get, post, remove } from "../lib/api.js";
import { html, useState } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { change, href } from "../lib/route.js";
import { mayChange, maySubmit } from "../lib/session.js";
import { Deliveries } from "../parts/deliveries.js";
import { Confirm, Failure, Loading, Pages } from "../parts/elements.js";
import { useProjects } from "../parts/whose.js";
import { ChangeWebhook, NewWebhook } from "./news/webhook.js";

const EVERY_MS = 3000;

/** The query's `project`, and `webhook`: whose deliveries are shown. */
export default function News({ query }) {
  const projects = useProjects();
  const project = query.get("project") || projects[0] || "default";
  const path = `/projects/${encodeURIComponent(project)}/webhooks`;
  const { data, error, again } = useLive((signal) => get(path, {}, { signal }), [path]);
  const [changing, setChanging] = useState(null);
  const find = (name) => data?.items.find((webhook) => webhook.name === name);
  const [chosen, changed] = [find(query.get("webhook")), find(changing)];
  return html`<div class="stack">
    <h1>News</h1>
    ${projects.length > 1 && html`<div class="tools"><label>Project
      <select value=${project} onChange=${({ target }) => change({ project: target.value, webhook: [], cursor: [] })}>${projects.map((name) => html`<option key=${name} value=${name}>${name}</option>`)}</select>
    </label></div>`}
    ${maySubmit() && !changed && html`<${NewWebhook} key=${path} path=${path} onMade=${again} />`}
    ${changed && html`<${ChangeWebhook} key=${`${path} ${changing}`} webhook=${changed} path=${of(path, changing)} onChanged=${again} onDone=${() => setChanging(null)} />`}
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data && !error && html`<${Loading} what="webhooks" />`}
    ${data && !data.items.length && html`<p class="facts">Nobody is told of the jobs of ${project} yet.</p>`}
    ${data?.items.length > 0 && html`<div class="card table stacking" tabindex="0" role="region" aria-label="Webhooks"><table>
      <thead><tr><th>Webhook</th><th>Address</th><th>Is told</th><th>Of jobs</th><th>Owner</th><th>Do</th></tr></thead>
      <tbody>${data.items.map((webhook) => html`<${Row} key=${webhook.name} webhook=${webhook} path=${of(path, webhook.name)} again=${again} change=${() => setChanging(webhook.name)} />`)}</tbody>
    </table></div>`}
    ${chosen && html`<${Sent} key=${`${path} ${chosen.name}`} webhook=${chosen} path=${of(path, chosen.name)} query=${query} />`}
  </div>`;
}

/** The address of a webhook, by that of its project's. */
const of = (path, name) => `${path}/${encodeURIComponent(name)}`;

function Row({ webhook, path, again, change: begin }) {
  const [problem, setProblem] = useState(null);
  const show = () => change({ project: webhook.project, webhook: webhook.name, cursor: [] });
  const test = () => post(`${path}/test`).then(show, setProblem);
  const discard = () => remove(path).then(again, setProblem);
  return html`<tr>
    <td data-label="Webhook"><a href=${href(["news"], { project: webhook.project, webhook: webhook.name })} title="What was sent to it">${webhook.name}</a></td>
    <td data-label="Address"><code>${webhook.url}</code></td>
    <td data-label="Is told">${webhook.events.join(", ")}</td>
    <td data-label="Of jobs">${webhook.jobs}</td>
    <td data-label="Owner">${webhook.owner || "–"}</td>
    <td data-label="Do"><span>
      ${webhook.stopped && html`<span class="facts">${webhook.stopped}</span>`}
      ${mayChange(webhook) && html`<span class="actions"><button type="button" onClick=${test} aria-label="Test ${webhook.name}">Test</button>
        <button type="button" onClick=${begin} aria-label="Change ${webhook.name}">Change</button>
        <${Confirm} text="Delete" question="Nothing more is sent to ${webhook.name}. Delete it?" onYes=${discard} isDangerous /></span>`}
      ${problem && html`<span class="error" role="alert">${problem.message}</span>`}
    </span></td>
  </tr>`;
}

function Sent({ webhook, path, query }) {
  const cursor = query.get("cursor");
  const load = (signal) => get(`${path}/deliveries`, { cursor }, { signal });
  const { data, error, again } = useLive(load, [cursor], EVERY_MS);
  return html`<section class="card stack">
    <h2>Sent to ${webhook.name} in the last week</h2>
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data && !error && html`<${Loading} what="deliveries" />`}
    ${data && !data.items.length && html`<p class="facts">Nothing yet.</p>`}
    ${data?.items.length > 0 && html`<${Deliveries} items=${data.items} what="job" onSent=${mayChange(webhook) && again} />`}
    ${data && html`<${Pages} path=${["news"]} query=${query} next=${data.next} name="Pages of deliveries" first="Newest" more="Older ones" />`}
  </section>`;
}
