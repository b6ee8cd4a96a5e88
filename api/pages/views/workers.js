/** Workers, and the queue: what waits, and why. */

import { everyItem, get } from "../lib/api.js";
import { ago, bytes, duration, moment } from "../lib/format.js";
import { html } from "../lib/html.js";
import { allocated, environmentOf, title, whyQueued } from "../lib/job.js";
import { useLive } from "../lib/live.js";
import { BusyHours, busyShare, percent } from "../parts/busy_hours.js";
import { Empty, Failure, Loading, Pages, Prose } from "../parts/elements.js";

const STATES = { ready: "ready", testing: "tests its device", device_failed: "device set aside", incomplete: "waits for its hosts",
  lent: "lent", kept: "keeps its GPU free" };

const LIMIT = 50;

export default function Workers({ query }) {
  const cursor = query.get("cursor");
  const { data, error, again } = useLive((signal) => load(cursor, signal), [cursor], 3000);
  if (!data) return error ? html`<${Failure} error=${error} again=${again} />` : html`<${Loading} what="workers" />`;
  return html`<div class="stack">
    <h1>Workers</h1>
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data.all.length && html`<${Empty}>
      <p>No worker is running, so jobs wait.</p>
      <p>Start one with <code>python -m worker.main</code>, or the whole service with <code>./run up</code>.</p>
    <//>`}
    <div class="grid">${data.workers.map((worker) => html`<${Worker} key=${worker.name} worker=${worker} all=${data.all} usage=${data.usage} />`)}</div>
    <${Pages} path=${["workers"]} query=${query} next=${data.next} name="Pages of workers" first="First workers" more="More workers" />
    <${Queue} queued=${data.queued} workers=${data.all} slots=${data.slots} usage=${data.usage} />
  </div>`;
}

/** A page of workers, and the queue: why a job waits depends on all workers, whichever are shown. */
async function load(cursor, signal) {
  const [page, queued, slots, usage] = await Promise.all([
    get("/workers", { cursor, limit: LIMIT }, { signal }),
    get("/jobs", { status: "queued", limit: 100 }, { signal }),
    get("/slots", {}, { signal }),
    lastDay(signal),
  ]);
  const isWhole = !cursor && !page.next;
  return { workers: page.items, next: page.next, all: isWhole ? page.items : await everyItem("/workers", { signal }), queued, slots, usage };
}

let usage;
let usageAt = 0;

/** How busy the devices were, and whose jobs wait: some seconds old, so that many open pages do not sum it all the time. */
async function lastDay(signal) {
  if (!usage || Date.now() - usageAt > 6_000) {
    usage = await get("/usage", {}, { signal });
    usageAt = Date.now();
  }
  return usage;
}

const Worker = ({ worker, all, usage }) => html`<section class="card">
  <h2>${worker.name}</h2>
  <dl class="facts-list">
    <dt>State</dt><dd>${state(worker)}${worker.problem ? `: ${worker.problem}` : ""}</dd>
    <dt>Device</dt><dd>${worker.device}${worker.hosts > 1 ? ` on each of ${worker.hosts} hosts` : ""}${worker.pool ? ` of ${worker.pool}, which jobs share out` : ""}${worker.seat ? "; only for jobs that share it" : ""}${worker.memory_bytes ? `, ${bytes(worker.memory_bytes)}` : ""}</dd>
    <${Beside} worker=${worker} all=${all} />
    <dt>Host</dt><dd>${worker.host}, process ${worker.pid}</dd>
    ${worker.allocation && html`<dt>Cluster</dt><dd>${allocated(worker.allocation)}</dd>`}
    <dt>Packages</dt><dd>${worker.packages?.join(", ") || "none beyond the needed"}</dd>
    <dt>Since</dt><dd>${moment(worker.started_at)}; seen ${ago(worker.seen_at)}</dd>
    <${Busy} worker=${worker} usage=${usage} />
  </dl>
</section>`;

/** The jobs with which its own one shares the GPU. */
function Beside({ worker, all }) {
  const others = all.filter((other) => other.host === worker.host && other.device === worker.device && other.seat !== worker.seat);
  const jobs = worker.pool && worker.jobs.length ? others.flatMap((other) => other.jobs) : [];
  return jobs.length > 0 && html`<dt>Shares</dt><dd>its GPU with ${linksTo(jobs)}</dd>`;
}

/** Of its device, also under workers before it, and under jobs of other workers to which it was lent. */
function Busy({ worker, usage }) {
  const own = usage.devices.filter(({ host, device }) => host === worker.host && (device === worker.device || (worker.pool && isAmong(worker.device, device))));
  const seconds = usage.hours.map((_, hour) => Math.min(3600, own.reduce((sum, device) => sum + device.seconds[hour], 0)));
  return html`<dt>Last day</dt><dd>busy for ${percent(busyShare(usage, seconds))}
    <${BusyHours} usage=${usage} seconds=${seconds} name=${worker.name} /></dd>`;
}

/** Whether `gpu:1` is one of `gpu:0,1`. */
const isAmong = (gpu, gpus) => gpus.startsWith("gpu:") && gpus.slice(4).split(",").includes(gpu.slice(4));

/** A job that it has just taken from the queue is not in `jobs` yet. */
function state({ state, job, jobs }) {
  const running = jobs.length ? jobs : [job].filter(Boolean);
  if (!running.length) return STATES[state];
  return html`runs ${running.length > 1 && `${running.length} jobs: `}${linksTo(running)}`;
}

const linksTo = (jobs) => jobs.map((id, number) => html`${number > 0 && ", "}<a key=${id} href="#/jobs/${id}">${id}</a>`);

/** What the queue asks for, by kind of worker. */
function Wanted({ slots }) {
  const waiting = slots.items.filter((slot) => slot.queued > 0);
  if (!waiting.length) return null;
  return html`<h3>By kind of worker</h3>
    <div class="table stacking" tabindex="0" role="region" aria-label="By kind of worker"><table>
      <thead><tr><th>Needs</th><th class="number">Waiting</th><th class="number">Running</th><th class="number">Longest wait</th></tr></thead>
      <tbody>${waiting.map((slot) => html`<tr key=${`${slot.accelerator}${slot.gpus}x${slot.hosts}`}>
        <td data-label="Needs">${needs(slot)}${slot.hosts > 1 ? `, on ${slot.hosts} hosts` : ""}</td>
        <td data-label="Waiting" class="number">${slot.queued}</td>
        <td data-label="Running" class="number">${slot.running}</td>
        <td data-label="Longest wait" class="number">${duration(slot.oldest_queued_s)}</td>
      </tr>`)}</tbody>
    </table></div>`;
}

/** Whose jobs wait. */
function ByProject({ usage }) {
  const waiting = usage.projects.filter((used) => used.queued > 0).sort((one, other) => other.queued - one.queued);
  if (!waiting.length) return null;
  return html`<h3>By project</h3>
    <div class="table stacking" tabindex="0" role="region" aria-label="By project"><table>
      <thead><tr><th>Project</th><th>User</th><th class="number">Waiting</th><th class="number">Running</th><th class="number">Longest wait</th></tr></thead>
      <tbody>${waiting.map((used) => html`<tr key=${`${used.project}/${used.owner}`}>
        <td data-label="Project">${used.project}</td>
        <td data-label="User">${used.owner || "–"}</td>
        <td data-label="Waiting" class="number">${used.queued}</td>
        <td data-label="Running" class="number">${used.running}</td>
        <td data-label="Longest wait" class="number">${duration(used.oldest_queued_s)}</td>
      </tr>`)}</tbody>
    </table></div>`;
}

function Queue({ queued, workers, slots, usage }) {
  const jobs = [...queued.items].reverse(); // The oldest is the next of its priority.
  return html`<section class="card"><h2>Queue</h2>
    ${!jobs.length && html`<p class="facts">Nothing waits.</p>`}
    <${Wanted} slots=${slots} />
    <${ByProject} usage=${usage} />
    ${jobs.length > 0 && html`<h3>Job by job</h3><div class="table stacking" tabindex="0" role="region" aria-label="Queue"><table>
      <thead><tr><th>Job</th><th>Priority</th><th>Needs</th><th>Waits since</th><th>Why</th></tr></thead>
      <tbody>${jobs.map((job) => html`<tr key=${job.id}>
        <td data-label="Job"><span><a href="#/jobs/${job.id}">${title(job)}</a> <span class="facts">${environmentOf(job.spec)}</span></span></td>
        <td data-label="Priority">${job.spec.priority || "normal"}</td>
        <td data-label="Needs">${needs(job.spec.resources)}</td>
        <td data-label="Waits since">${ago(job.created_at)}</td>
        <td data-label="Why"><span><${Prose} text=${whyQueued(job, workers)} /></span></td>
      </tr>`)}</tbody>
    </table></div>`}
    ${queued.next && html`<p class="facts">The newest 100 are shown. <a href="#/jobs?status=queued">All queued jobs</a></p>`}
  </section>`;
}

function needs(resources = {}) {
  if (resources.hosts > 1) return `${resources.accelerator === "cpu" ? "the CPUs" : `${resources.gpus} GPUs`} of ${resources.hosts} hosts`;
  if (resources.gpus > 1) return `${resources.gpus} GPUs of one host`;
  if (resources.share_gpu) return "a part of a GPU";
  return { cpu: "a CPU", gpu: "a GPU" }[resources.accelerator] || "any device";
}
