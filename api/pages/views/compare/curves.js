/** One metric of several jobs over each other, to export as a table or a picture. */

import { across, curveOf, smooth } from "../../lib/curves.js";
import { pictureOf, save, toCsv } from "../../parts/downloads.js";
import { html, useRef, useState } from "../../lib/html.js";
import { isOver, RETURNS } from "../../lib/job.js";
import { useLive } from "../../lib/live.js";
import { Chart } from "../../parts/chart.js";
import { bandLines, bySetting } from "../../lib/seeds.js";
import { CurveTools, setRange, toolsOf } from "../../parts/curve_tools.js";
import { Failure } from "../../parts/elements.js";
import { change } from "../../lib/route.js";

const POINTS = 400;
const EXPORTED_POINTS = 10_000;

export function Curves({ jobs, query }) {
  const tools = toolsOf(query);
  const names = [...new Set(jobs.flatMap((job) => Object.keys(job.progress.metrics)))].sort();
  const metric = query.get("metric") || RETURNS.find((name) => names.includes(name)) || names[0] || RETURNS[0];
  const isClose = tools.range && tools.x === "steps";
  const range = isClose ? { first_step: tools.range[0], last_step: tools.range[1] } : {};
  const { data, error, again } = useLive(
    (signal) => Promise.all(jobs.map((job) => curveOf(job.links.metrics, metric, { points: POINTS, ...range }, signal))),
    [jobs.map((job) => job.id).join(), metric, JSON.stringify(range)],
    () => (jobs.some((job) => !isOver(job)) ? 4000 : 0),
  );
  const place = useRef();
  const [isBusy, setBusy] = useState(false);
  const exportCsv = async () => {
    setBusy(true);
    const curves = await Promise.all(jobs.map((job) => curveOf(job.links.metrics, metric, { points: EXPORTED_POINTS, ...range })));
    save(`${fileName(metric)}.csv`, new Blob([toCsv(jobs.map((job, i) => [job, curves[i]]), metric)], { type: "text/csv" }));
    setBusy(false);
  };
  const exportPng = async () => {
    const smoothed = tools.smoothing ? `, smoothed by ${tools.smoothing}` : "";
    const title = `${metric} of ${jobs.length} ${jobs.length === 1 ? "job" : "jobs"}${smoothed}`;
    const told = { title, across: tools.x === "time" ? "wall time" : "steps", up: `${metric}${tools.log ? ", log" : ""}`, lines };
    save(`${fileName(metric)}.png`, await pictureOf(place.current, told));
  };
  const single = new Map(jobs.flatMap((job, i) => (data?.[i] ? [[job.id, lineOf(job, data[i], tools)]] : [])));
  const groups = bySetting(jobs);
  const hasSeeds = groups.length < jobs.length;
  const lines = hasSeeds && query.get("seeds") === "band" ? groups.flatMap((group) => bandOf(group, single)) : [...single.values()];
  return html`<section class="card" aria-label="Curves">
    <${CurveTools} tools=${tools}>
      <label>Metric
        <select value=${metric} onChange=${(event) => change({ metric: event.target.value }, true)}>
          ${[...new Set([metric, ...names])].map((name) => html`<option value=${name}>${name}</option>`)}
        </select>
      </label>
      ${hasSeeds && html`<label class="inline"><input type="checkbox" checked=${query.get("seeds") === "band"}
        onChange=${(event) => change({ seeds: event.target.checked ? "band" : [] }, true)} /> Seeds as a band</label>`}
    <//>
    ${error && html`<${Failure} error=${error} again=${again} />`}
    <div ref=${place}>
      <${Chart} title=${metric} lines=${lines} x=${tools.x} log=${tools.log} range=${tools.range} onRange=${setRange} height=${340} />
    </div>
    <p class="actions">
      <button type="button" disabled=${isBusy || !lines.length} onClick=${exportCsv}>Export CSV</button>
      <button type="button" disabled=${!lines.length} onClick=${exportPng}>Export PNG</button>
      <span class="facts">The CSV has up to 10,000 values of each job; ${" "}<a href=${query.get("ids") && `#/jobs/${jobs[0].id}/curves`}>all rows</a> are on a job's own page.</span>
    </p>
  </section>`;
}

const fileName = (metric) => metric.replaceAll("/", "-");

const lineOf = (job, curve, tools) => ({
  label: job.label,
  colour: job.colour,
  isDashed: job.isDashed,
  xs: across(curve, tools.x, job.started_at || job.created_at),
  ys: smooth(curve.values, tools.smoothing),
});

/** The lines of jobs that differ only in their seed: the edges of their band, and the mean. */
function bandOf(group, single) {
  const own = group.flatMap((job) => (single.has(job.id) ? [single.get(job.id)] : []));
  if (own.length < 2) return own;
  return bandLines(own, `${own[0].label} and ${own.length - 1} more ${own.length > 2 ? "seeds" : "seed"}, mean`);
}
