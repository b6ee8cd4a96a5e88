/** All jobs, newest first: filters, search and labels in the address; some of them picked for comparison. */

import { get, send, withQuery } from "../lib/api.js";
import { ago, bytes, value } from "../lib/format.js";
import { html, useEffect, useRef, useState } from "../lib/html.js";
import { algorithmOf, environmentOf, isOver, labelsOf, lastReturn, RETURNS, seedsOf, title } from "../lib/job.js";
import { useLive } from "../lib/live.js";
import { change, go, href } from "../lib/route.js";
import { Empty, Failure, Loading, Pages, Prose } from "../parts/elements.js";
import { Labels, Progress, Sparkline, Status, Thumbnail } from "../parts/job_row.js";
import { ProjectChoice, WHOSE, whose, WhoseFilters } from "../parts/whose.js";

export function Import() {
  const [state, setState] = useState({});
  const [project, setProject] = useState();
  // It takes minutes, and whoever has gone on to another view stays there.
  const isHere = useRef(true);
  useEffect(() => () => (isHere.current = false), []);
  const bring = async ({ target: input }) => {
    const [file] = input.files;
    if (!file) return;
    setState({ text: `Sending ${file.name} (${bytes(file.size)})…` });
    try {
      const job = await (await send(withQuery("/jobs/import", { project }), { method: "POST", body: file, type: "application/zip" })).json();
      if (isHere.current) go(["jobs", job.id]);
    } catch (error) {
      setState({ error });
    }
    input.value = "";
  };
  return html`<details class="import">
    <summary>Import an export</summary>
    <label class="field">The zip that “Export” of a job gives, here or on another service:
      <input type="file" accept=".zip" onChange=${bring} />
    </label>
    <${ProjectChoice} value=${project} onChange=${setProject} />
    <p role="status">${state.text || ""}</p>
    ${state.error && html`<${Failure} error=${state.error} />`}
  </details>`;
}

const STATUSES = ["queued", "starting", "running", "cancelling", "succeeded", "failed", "cancelled"];
const FILTERS = ["search", "status", "kind", "environment", "label", ...WHOSE];
const LIMIT = 25;

export default function Jobs({ query }) {
  const asked = Object.fromEntries(FILTERS.map((name) => [name, query.getAll(name)]));
  const cursor = query.get("cursor");
  const picked = query.getAll("pick");
  const { data, error, again } = useLive(
    (signal, isRepeated) => get("/jobs", { ...asked, cursor, limit: LIMIT }, { signal, maxAge: isRepeated ? 1 : 0 }),
    [JSON.stringify(asked), cursor],
    (page) => (page.items.some((job) => !isOver(job)) ? 2000 : 5000),
  );
  const isFiltered = Object.values(asked).some((values) => values.length);
  return html`
    <div class="title">
      <h1>Jobs</h1>
      <a class="button" href="#/submit">Submit a job</a>
    </div>
    <${Filters} asked=${asked} />
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data && !error && html`<${Loading} what="jobs" />`}
    ${data && !data.items.length && html`<${Nothing} isFiltered=${isFiltered || cursor} />`}
    ${data && data.items.length > 0 &&
    html`<ul class="jobs" aria-label="Jobs">
      ${data.items.map((job) => html`<${Row} key=${job.id} job=${job} picked=${picked} />`)}
    </ul>`}
    ${data && html`<${Pages} path=${["jobs"]} query=${query} next=${data.next} name="Pages of jobs" first="Newest" more="Older jobs" />`}
    <${Import} />
    ${picked.length > 0 && html`<${Picked} ids=${picked} />`}
  `;
}

function Filters({ asked }) {
  const [search, setSearch] = useState(asked.search[0] || "");
  const [refused, setRefused] = useState(null); // A label that is none.
  const timer = useRef();
  useEffect(() => () => clearTimeout(timer.current), []);
  const set = (parts, quietly) => change({ ...parts, cursor: [] }, quietly);
  const type = (event) => {
    const text = event.target.value;
    setSearch(text);
    clearTimeout(timer.current);
    timer.current = setTimeout(() => set({ search: text }, true), 250);
  };
  const addLabel = (event) => {
    event.preventDefault();
    const input = event.target.elements.label;
    const isLabel = /^[\w.-]+[:=]/.test(input.value);
    setRefused(isLabel || !input.value ? null : input.value);
    if (!isLabel) return;
    set({ label: [...asked.label, input.value.replace("=", ":")] });
    input.value = "";
  };
  return html`<search class="filters">
    <label>Search <input type="search" value=${search} onInput=${type} placeholder="name or environment" /></label>
    <label>Status
      <select value=${asked.status[0] || ""} onChange=${(event) => set({ status: event.target.value })}>
        <option value="">any</option>
        ${STATUSES.map((status) => html`<option value=${status}>${status}</option>`)}
      </select>
    </label>
    <label>Kind
      <select value=${asked.kind[0] || ""} onChange=${(event) => set({ kind: event.target.value })}>
        <option value="">any</option><option value="train">train</option><option value="rollout">rollout</option>
      </select>
    </label>
    <${WhoseFilters} asked=${asked} />
    <form onSubmit=${addLabel} novalidate>
      <label>Label <input name="label" placeholder="key:value" aria-invalid=${refused ? "true" : undefined} aria-describedby=${refused ? "label-error" : undefined} /></label>
    </form>
    ${["environment", "label"].flatMap((name) =>
      asked[name].map(
        (value) => html`<button type="button" class="label" aria-label="Remove the filter ${value}"
          onClick=${() => set({ [name]: asked[name].filter((other) => other !== value) })}>${value} ×</button>`,
      ),
    )}
    ${refused && html`<p class="error" id="label-error" role="alert">A label is a key and a value with a colon between them, such as <code>team:legs</code>; “${refused}” has no colon after a key.</p>`}
  </search>`;
}

function Row({ job, picked }) {
  const isPicked = picked.includes(job.id);
  const pick = () => change({ pick: isPicked ? picked.filter((id) => id !== job.id) : [...picked, job.id] }, true);
  const here = href(["jobs", job.id]);
  const environment = environmentOf(job.spec);
  const last = lastReturn(job);
  return html`<li class="job">
    <label class="pick"><input type="checkbox" checked=${isPicked} onChange=${pick} aria-label="Compare ${title(job)}" /></label>
    <${Thumbnail} job=${job}><span>${environment}</span><//>
    <div class="about">
      <h2><a href=${here}>${title(job)}</a></h2>
      <p class="facts">
        <a href=${href(["jobs"], { environment })}>${environment}</a>
        ${` · ${algorithmOf(job) || job.kind}${seedsOf(job).length ? ` · seeds ${seedsOf(job).join(", ")}` : job.spec.seed === undefined ? "" : ` · seed ${job.spec.seed}`}${job.imported_from ? " · imported" : ""}${whose(job)} · `}<time datetime=${job.created_at}>${ago(job.created_at)}</time>
      </p>
      <${Labels} labels=${labelsOf(job)} hrefOf=${(key, value) => href(["jobs"], { label: `${key}:${value}` })} />
    </div>
    <div class="how">
      <${Status} job=${job} />
      <${Progress} job=${job} />
      <${Why} job=${job} />
    </div>
    <${Sparkline} job=${job.id} metrics=${RETURNS} step=${job.progress.step} isOver=${isOver(job)} name="Return">
      ${last !== null && html`<span class="facts">return ${value(last)}</span>`}
    <//>
  </li>`;
}

/** Why it waits, or why it did not succeed. */
function Why({ job }) {
  const text = job.waiting_for || job.turn?.reason || (job.status !== "succeeded" && job.message);
  return text ? html`<p class="facts why"><${Prose} text=${text} /></p>` : null;
}

const Nothing = ({ isFiltered }) =>
  html`<${Empty}>
    ${isFiltered
      ? html`<p>No job matches these filters.</p><p><a href="#/jobs">Show all jobs</a></p>`
      : html`<p>No jobs yet.</p>
          <p><a class="button" href="#/submit">Submit the first one</a></p>
          <p>Or from a shell: <code>gaitway submit ant</code></p>`}
  <//>`;

const Picked = ({ ids }) =>
  html`<div class="picked" role="status">
    <span>${ids.length} picked</span>
    <a class="button" href=${href(["compare"], { ids: ids.join(",") })}>Compare</a>
    <button type="button" class="plain" onClick=${() => change({ pick: [] }, true)}>Clear</button>
  </div>`;
