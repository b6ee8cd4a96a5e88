/** Every metric of a job, live. */

import { across, smooth, useCurves } from "../../lib/curves.js";
import { html } from "../../lib/html.js";
import { change } from "../../lib/route.js";
import { Chart } from "../../parts/chart.js";
import { CurveTools, setRange, toolsOf } from "../../parts/curve_tools.js";
import { Empty, Failure, Loading } from "../../parts/states.js";

export function CurvesTab({ job, query, onMetrics }) {
  const tools = toolsOf(query);
  const wanted = (query.get("metric") || "").toLowerCase();
  const isClose = tools.range && tools.x === "steps"; // The server then sends more of the part that is shown.
  const asked = isClose ? { points: 400, first_step: tools.range[0], last_step: tools.range[1] } : { points: 400 };
  const { curves, error } = useCurves(job, onMetrics, asked);
  if (error) return html`<${Failure} error=${error} />`;
  if (!curves) return html`<${Loading} what="curves" />`;
  const names = [...curves.byName.keys()].sort().filter((name) => name.toLowerCase().includes(wanted));
  return html`
    <${CurveTools} tools=${tools}>
      <label>Metrics <input type="search" value=${wanted} placeholder="part of a name" onInput=${(event) => change({ metric: event.target.value }, true)} /></label>
    <//>
    <p class="facts"><a href="${job.links.metrics}?format=csv" download>All rows as CSV</a> · drag over a curve to look closer, double-click to see all</p>
    ${!curves.byName.size && html`<${Empty}><p>${nothing(job)}</p><//>`}
    ${curves.byName.size > 0 && !names.length && html`<${Empty}><p>No metric has “${wanted}” in its name.</p><//>`}
    <div class="grid">
      ${names.map((name) => html`<section class="card" key=${name}>
        <${Chart} title=${name} lines=${linesOf(curves.byName.get(name), name, tools, job)} x=${tools.x} log=${tools.log}
          range=${tools.range} onRange=${setRange} height=${180} sync="curves" />
      </section>`)}
    </div>
  `;
}

const nothing = (job) =>
  ["succeeded", "failed", "cancelled"].includes(job.status)
    ? "The job ended before it measured anything."
    : "Nothing measured yet. The first values come after the first update, which has to be compiled.";

/** The curve; with smoothing, its values as they are stand faintly behind. */
function linesOf(curve, name, tools, job) {
  const xs = across(curve, tools.x, job.started_at || job.created_at);
  const label = name.split("/").at(-1);
  if (!tools.smoothing) return [{ label, xs, ys: curve.values, colour: "--curve-1" }];
  return [
    { label: "measured", xs, ys: curve.values, colour: "--curve-1", faint: true },
    { label: "smoothed", xs, ys: smooth(curve.values, tools.smoothing), colour: "--curve-1" },
  ];
}
