/** Every metric of a job, live: in sections, what somebody pinned and what matters most first. */

import { across, smooth, useCurves } from "../../lib/curves.js";
import { html } from "../../lib/html.js";
import { HINTS, OPEN, sectionsOf, useStoredList } from "../../lib/sections.js";
import { isOfASeed, seedLines } from "../../lib/seeds.js";
import { change } from "../../lib/route.js";
import { Chart } from "../../parts/chart.js";
import { CurveTools, setRange, toolsOf } from "../../parts/curve_tools.js";
import { Empty, Failure, Loading } from "../../parts/elements.js";

export function CurvesTab({ job, query, onMetrics }) {
  const tools = toolsOf(query);
  const wanted = (query.get("metric") || "").toLowerCase();
  const isClose = tools.range && tools.x === "steps"; // The server then sends more of the part that is shown.
  const asked = isClose ? { points: 400, first_step: tools.range[0], last_step: tools.range[1] } : { points: 400 };
  const [pins, pin] = useStoredList("gaitway-pins");
  const [turned, turn] = useStoredList("gaitway-curve-sections"); // Those that are not as they are at first.
  const { curves, error } = useCurves(job, onMetrics, asked);
  if (error) return html`<${Failure} error=${error} />`;
  if (!curves) return html`<${Loading} what="curves" />`;
  const names = [...curves.byName.keys()].filter((name) => name.toLowerCase().includes(wanted) && (!isOfASeed(name) || wanted.startsWith("seed")));
  const draw = (name) => html`<section class="card pinnable" key=${name}>
    <button type="button" class="plain pin" aria-pressed=${pins.includes(name)} aria-label="Pin ${name}" title="Show it first, on this browser" onClick=${() => pin(name)}>${pins.includes(name) ? "★" : "☆"}</button>
    <${Chart} title=${name} lines=${[...linesOf(curves.byName.get(name), name, tools, job), ...seedLines(curves, name, tools, job)]} x=${tools.x} log=${tools.log}
      range=${tools.range} onRange=${setRange} height=${180} sync="curves" />
  </section>`;
  return html`
    <${CurveTools} tools=${tools}>
      <label>Metrics <input type="search" value=${wanted} placeholder="part of a name" onInput=${(event) => change({ metric: event.target.value }, true)} /></label>
    <//>
    <p class="facts"><a href="${job.links.metrics}?format=csv" download>All rows as CSV</a> · drag over a curve to look closer, double-click to see all</p>
    ${!curves.byName.size && html`<${Empty}><p>${nothing(job)}</p><//>`}
    ${curves.byName.size > 0 && !names.length && html`<${Empty}><p>No metric has “${wanted}” in its name.</p><//>`}
    ${sectionsOf(names, pins).map(([title, inside]) => html`<${Section} key=${title} title=${title} names=${inside} draw=${draw}
      isOpen=${Boolean(wanted) || OPEN.includes(title) !== turned.includes(title)} turn=${() => turn(title)} />`)}
  `;
}

/** Some curves under a heading; those of a closed section are not drawn. */
function Section({ title, names, draw, isOpen, turn }) {
  const click = (event) => (event.preventDefault(), turn());
  return html`<details class="curves" open=${isOpen}>
    <summary onClick=${click}>${title} <span class="facts">${names.length}</span></summary>
    ${isOpen && HINTS[title] && html`<p class="facts">${HINTS[title]}</p>`}
    ${isOpen && html`<div class="grid">${names.map(draw)}</div>`}
  </details>`;
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
