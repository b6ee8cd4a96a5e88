/** The columns of the table of jobs, and which of them are shown: a choice that the browser keeps. */

import { ago, compact, duration, moment, seconds, value } from "../../lib/format.js";
import { html, useState } from "../../lib/html.js";
import { algorithmOf, environmentOf, isOver, labelsOf, lastReturn, newest, RETURNS, seedsOf } from "../../lib/job.js";
import { href } from "../../lib/route.js";
import { session } from "../../lib/session.js";
import { isOver as isSweepOver, objectivesOf } from "../../lib/sweep.js";
import { Prose } from "../../parts/elements.js";
import { Labels, Sparkline, Status, Steps, Thumbnail } from "../../parts/job_row.js";

const KEY = "gaitway-columns";

const Created = ({ of }) => html`<time datetime=${of.created_at} title=${moment(of.created_at)}>${ago(of.created_at)}</time>`;

const lasted = (from, until) => (from ? duration(Math.max(0, seconds(from, until || Date.now()))) : "");

const attemptWith = (job, fact) => [...job.attempts].reverse().find((attempt) => attempt[fact])?.[fact] || "";

/** Why it waits, or why it did not succeed. */
function Why({ job }) {
  const text = job.waiting_for || job.turn?.reason || (job.status !== "succeeded" && job.message);
  return text ? html`<p class="facts why" title=${text}><${Prose} text=${text} /></p>` : null;
}

const counted = ({ num_trials: counts }) => Object.entries(counts).map(([status, number]) => `${number} ${status}`).join(", ");

function Trials({ sweep }) {
  const begun = Object.values(sweep.num_trials).reduce((sum, number) => sum + number, 0);
  const going = ["queued", "starting", "running", "cancelling"].reduce((sum, status) => sum + (sweep.num_trials[status] || 0), 0);
  const ended = begun - going;
  return html`<div class="progress">
    ${!isSweepOver(sweep) && html`<progress max=${sweep.max_trials} value=${ended} aria-label="Trials of the sweep that have ended"></progress>`}
    <span class="facts">${ended} of ${sweep.max_trials} trials</span>
  </div>`;
}

function Best({ sweep }) {
  const [best] = sweep.best;
  const { metric } = objectivesOf(sweep)[0];
  return best ? html`<span title="The best ${metric}">${value(best.values[0])}</span>${!RETURNS.includes(metric) && html`<span class="facts"> ${metric}</span>`}` : "";
}

/**
 * By name. cell: of a job; sweep: of a sweep and the first of its jobs. sort: the service's name of the column;
 * first: the order that a click begins with. kind: `number` stands to the right.
 */
const COLUMNS = {
  picture: {
    title: "Picture",
    cell: (job) => newest(job, "poster") && html`<${Thumbnail} job=${job} />`,
  },
  status: {
    title: "Status",
    sort: "status",
    first: "asc",
    cell: (job) => html`<${Status} job=${job} /><${Why} job=${job} />`,
    sweep: (sweep) => html`<${Status} job=${sweep} /><p class="facts why" title=${counted(sweep)}>${counted(sweep)}</p>`,
  },
  environment: {
    title: "Environment",
    sort: "environment",
    first: "asc",
    cell: (job) => html`<a class="quiet-link" href=${href(["jobs"], { environment: environmentOf(job.spec) })}>${environmentOf(job.spec)}</a>`,
  },
  kind: { title: "Kind", sort: "kind", first: "asc", cell: (job) => algorithmOf(job) || job.kind },
  steps: { title: "Steps", sort: "steps", cell: (job) => html`<${Steps} job=${job} />`, sweep: (sweep) => html`<${Trials} sweep=${sweep} />` },
  return: {
    title: "Return",
    sort: "return",
    isNumber: true,
    cell: (job) => (lastReturn(job) === null ? "" : value(lastReturn(job))),
    sweep: (sweep) => html`<${Best} sweep=${sweep} />`,
  },
  curve: {
    title: "Curve",
    cell: (job) => html`<${Sparkline} job=${job.id} metrics=${RETURNS} step=${job.progress.step} isOver=${isOver(job)} name="Return" />`,
    sweep: () => "",
  },
  speed: {
    title: "Steps/s",
    sort: "steps_per_second",
    isNumber: true,
    cell: (job) => (job.progress.steps_per_second ? compact(job.progress.steps_per_second) : ""),
    sweep: () => "",
  },
  duration: {
    title: "Duration",
    sort: "duration",
    isNumber: true,
    cell: (job) => lasted(job.started_at, job.finished_at),
    sweep: (sweep) => lasted(sweep.created_at, sweep.finished_at),
  },
  created: { title: "Created", sort: "created", isNumber: true, cell: (job) => html`<${Created} of=${job} />`, sweep: (sweep) => html`<${Created} of=${sweep} />` },
  owner: { title: "Owner", sort: "owner", first: "asc", isOfAccounts: true, cell: (job) => job.owner ?? "nobody" },
  project: { title: "Project", sort: "project", first: "asc", isOfAccounts: true, cell: (job) => job.project },
  seed: { title: "Seed", isNumber: true, cell: (job) => (seedsOf(job).length ? seedsOf(job).join(", ") : job.spec.seed ?? ""), sweep: () => "" },
  attempts: { title: "Attempts", sort: "attempts", isNumber: true, cell: (job) => job.attempts.length || "", sweep: () => "" },
  device: { title: "Device", sort: "device", first: "asc", cell: (job) => attemptWith(job, "device"), sweep: () => "" },
  engine: { title: "Engine", sort: "engine", first: "asc", cell: (job) => attemptWith(job, "engine"), sweep: () => "" },
  note: { title: "Note", cell: (job) => job.note && html`<p class="why" title=${job.note}>${job.note}</p>`, sweep: () => "" },
  labels: {
    title: "Labels",
    cell: (job, labelled) => html`<${Labels} labels=${ownLabels(job)} hrefOf=${labelled} />`,
    sweep: (sweep, _, labelled) => html`<${Labels} labels=${sweep.labels} hrefOf=${labelled} />`,
  },
};
const DEFAULT = ["picture", "status", "environment", "kind", "steps", "return", "curve", "speed", "duration", "created", "owner", "labels"];

/** Its labels, of a trial without those that name its sweep. */
function ownLabels(job) {
  const { sweep, trial, ...own } = labelsOf(job);
  return job.sweep ? own : labelsOf(job);
}

/** A column for the values of a label. */
const labelColumn = (key) => ({
  title: key,
  sort: `label:${key}`,
  first: "asc",
  cell: (job) => job.labels[key] ?? "",
  sweep: (sweep) => sweep.labels[key] ?? "",
});

const LABEL = "label:";
const columnOf = (name) => (name.startsWith(LABEL) ? labelColumn(name.slice(LABEL.length)) : COLUMNS[name]);

function kept() {
  try {
    const names = JSON.parse(localStorage.getItem(KEY));
    return Array.isArray(names) ? names.filter((name) => typeof name === "string" && columnOf(name)) : DEFAULT;
  } catch {
    return DEFAULT;
  }
}

/**
 * @param {object[]} jobs On the page; their labels may be columns, too.
 * @returns shown: the columns in their order, each with its name; offered: all names; set: choose others.
 */
export function useColumns(jobs) {
  const [names, setNames] = useState(kept);
  const set = (next) => {
    setNames(next || DEFAULT);
    if (next) localStorage.setItem(KEY, JSON.stringify(next));
    else localStorage.removeItem(KEY);
  };
  const labels = jobs.flatMap((job) => Object.keys(ownLabels(job)).map((key) => LABEL + key));
  const all = [...new Set([...Object.keys(COLUMNS), ...names, ...labels.sort()])];
  const offered = all.filter((name) => session().accounts || !columnOf(name).isOfAccounts);
  const shown = offered.filter((name) => names.includes(name)).map((name) => ({ name, ...columnOf(name) }));
  return { shown, offered, names, set };
}

export function ColumnMenu({ columns: { offered, names, set } }) {
  const toggle = (name) => set(names.includes(name) ? names.filter((other) => other !== name) : [...names, name]);
  return html`<details class="menu">
    <summary>Columns</summary>
    <div class="card">
      <ul>${offered.map((name) => html`<li key=${name}><label class="inline"><input type="checkbox" checked=${names.includes(name)} onChange=${() => toggle(name)} />
        ${name.startsWith(LABEL) ? `label ${columnOf(name).title}` : columnOf(name).title}</label></li>`)}</ul>
      <button type="button" class="plain" onClick=${() => set(null)}>Default columns</button>
    </div>
  </details>`;
}
