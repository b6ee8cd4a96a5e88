/** The job at a glance: video, return, reward by term, costs, attempts. */

import { get } from "../../lib/api.js";
import { bytes, count, duration, moment, seconds, value } from "../../lib/format.js";
import { across, smooth, useCurves } from "../../lib/curves.js";
import { html, useState } from "../../lib/html.js";
import { allocated, newest, RETURNS, seedsOf } from "../../lib/job.js";
import { useLive } from "../../lib/live.js";
import { href } from "../../lib/route.js";
import { metricOfSeed, seedLines } from "../../lib/seeds.js";
import { percent } from "../../parts/busy_hours.js";
import { Chart } from "../../parts/chart.js";
import { CurveTools, setRange, toolsOf } from "../../parts/curve_tools.js";
import { Deliveries } from "../../parts/deliveries.js";
import { Films } from "../../parts/films.js";
import { Failure, Prose } from "../../parts/elements.js";
import { Battery } from "./battery.js";
import { Costs } from "./costs.js";
import { Latent } from "./latent.js";
import { NewestReplay, replaysOf } from "./replay.js";

const TOLD_EVERY_MS = 3000;
// Terms of the reward, as environments name them.
const TERM = /^eval\/episode_((?:reward|cost)_.+)$/;
// The share of the environments that train at a level of the terrain.
const LEVEL = /^training\/terrain_level_(\d+)$/;

export function OverviewTab({ job, query, onMetrics, onPhase }) {
  return html`<div class="stack">
    <div class="halves">
      <section class="card" aria-label="Video"><${FilmsAndForks} job=${job} query=${query} /></section>
      ${job.kind === "train" && html`<section class="card" aria-label="Return"><${Return} job=${job} query=${query} onMetrics=${onMetrics} /></section>`}
      <${Summary} job=${job} />
    </div>
    <div class="halves">
      <${Terms} metrics=${job.progress.metrics} />
      <${Levels} metrics=${job.progress.metrics} />
      <${Costs} job=${job} onPhase=${onPhase} />
    </div>
    <${Battery} job=${job} />
    <${Latent} job=${job} />
    <${Attempts} job=${job} />
    <${Told} job=${job} />
  </div>`;
}

function FilmsAndForks({ job, query }) {
  const [step, setStep] = useState(null);
  const checkpoints = job.artifacts.filter((file) => file.role === "checkpoint").sort((a, b) => a.step - b.step);
  const replay = replaysOf(job).find((file) => step === null || file.step === step);
  const checkpoint = checkpoints.find((file) => file.step === step) || (step === null ? checkpoints.at(-1) : null);
  return html`
    <${Films} job=${job} onStep=${setStep}><${NewestReplay} job=${job} query=${query} /><//>
    ${replay && html`<p><a href=${href(["jobs", job.id, "replay"], { seed: job.shownSeed, ...(step === null ? {} : { step }) })}>See it from any side</a></p>`}
    ${checkpoints.length > 0 &&
    html`<p class="actions">
      ${checkpoint
        ? html`<a class="button" href=${href(["submit"], { fork: job.id, step: checkpoint.step })}>Fork from this checkpoint</a>
            <a href=${href(["submit"], { roll: job.id, step: checkpoint.step, seed: job.shownSeed })}>Roll it out</a>`
        : html`<span class="facts">This video's checkpoint is no longer kept.</span>`}
    </p>`}
  `;
}

function Return({ job, query, onMetrics }) {
  const tools = toolsOf(query);
  const { curves, error, version } = useCurves(job, onMetrics, { points: 400, metric: [...RETURNS, ...seedsOf(job).flatMap((seed) => RETURNS.map((name) => metricOfSeed(seed, name)))] });
  if (error) return html`<${Failure} error=${error} />`;
  const lines = RETURNS.flatMap((name, i) => {
    const curve = curves?.byName.get(name);
    if (!curve) return [];
    const xs = across(curve, tools.x, job.started_at || job.created_at);
    const label = name.replace("/episode_reward", "");
    const colour = `--curve-${i + 1}`;
    return [{ label, xs, ys: smooth(curve.values, tools.smoothing), colour }, ...seedLines(curves, name, tools, job, colour, `${label}, `)];
  });
  return html`<${Chart} title="Return" version=${version} lines=${lines} x=${tools.x} log=${tools.log} range=${tools.range} onRange=${setRange} height=${250} />
    <${CurveTools} tools=${tools} />
    <${Best} job=${job} />`;
}

/** The best evaluation so far, whose policy is kept beside the last one. */
function Best({ job }) {
  const best = newest(job, "best_policy");
  if (!best) return null;
  return html`<p class="facts">Best: return ${value(best.metadata.return)} at step ${count(best.step)}. <a href=${best.href} download=${best.name}>Download its policy</a>, or <a href=${href(["submit"], { roll: job.id, which: "best", seed: job.shownSeed })}>roll it out</a>.</p>`;
}

/** What a rollout found. */
function Summary({ job }) {
  if (job.kind !== "rollout") return null;
  const metrics = Object.entries(job.progress.metrics);
  return html`<section class="card"><h2>Result</h2>
    ${metrics.length
      ? html`<dl class="facts-list">${metrics.map(([name, number]) => html`<dt>${name}</dt><dd>${value(number)}</dd>`)}</dl>`
      : html`<p class="facts">Nothing measured yet.</p>`}
  </section>`;
}

function Terms({ metrics }) {
  const terms = Object.entries(metrics).filter(([name]) => TERM.test(name) && !name.endsWith("_std"));
  if (!terms.length) return null;
  return html`<section class="card"><h2>Reward by term</h2>
    <${Bars} rows=${terms.map(([name, number]) => ({ name: TERM.exec(name)[1], number, said: value(number) }))} />
    <p class="facts">In an episode of the newest evaluation.</p>
  </section>`;
}

function Levels({ metrics }) {
  const levels = Object.entries(metrics).flatMap(([name, share]) => (LEVEL.test(name) ? [[Number(LEVEL.exec(name)[1]), share]] : []));
  if (!levels.length) return null;
  levels.sort(([one], [other]) => one - other);
  return html`<section class="card"><h2>Levels of the terrain</h2>
    <${Bars} rows=${levels.map(([level, share]) => ({ name: `level ${level}`, number: share, said: `${value(100 * share)} %` }))} />
    <p class="facts">Where the environments train now, at level ${value(metrics["training/terrain_level"])} in the mean. An environment goes up when it
    leaves its terrain, and down when it falls or falls behind.</p>
  </section>`;
}

function Bars({ rows }) {
  const most = Math.max(...rows.map(({ number }) => Math.abs(number)), 1e-12);
  return html`<ul class="bars">
    ${rows.map(
      ({ name, number, said }) => html`<li key=${name}>
        <span>${name.split("_").map((part, at) => (at ? html`_<wbr />${part}` : part))}</span>
        <svg class="bar" viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true">
          <rect class=${number < 0 ? "minus" : ""} width=${(100 * Math.abs(number)) / most} height="8" />
        </svg>
        <span class="facts">${said}</span>
      </li>`,
    )}
  </ul>`;
}

/** Who was told of the job. For a minute after its end, and while something waits, there may be more. */
function Told({ job }) {
  const hasJustEnded = job.finished_at && seconds(job.finished_at, Date.now()) < 60;
  const every = ({ items }) => (hasJustEnded || items.some(({ status }) => status === "waiting") ? TOLD_EVERY_MS : 0);
  const { data } = useLive((signal) => get(`/jobs/${job.id}/deliveries`, {}, { signal }), [job.id, job.status], every);
  if (!data?.items.length) return null;
  return html`<section class="card"><h2>News of it</h2><${Deliveries} items=${data.items} what="webhook" /></section>`;
}

/** What it had of a GPU's memory, and whether others have a part of it, too. */
const memory = ({ gpu_part, peak_bytes }) => html`${gpu_part && html`<br /><span class="facts">shares the GPU: ${percent(gpu_part)} of its memory</span>`}
  ${peak_bytes && html`<br /><span class="facts">${bytes(peak_bytes)} of memory at most</span>`}`;

function Attempts({ job }) {
  if (!job.attempts.length) return null;
  return html`<section class="card"><h2>Attempts</h2><div class="table stacking" tabindex="0" role="region" aria-label="Attempts">
    <table>
      <thead><tr><th>#</th><th>Worker</th><th>Device</th><th>Engine</th><th>Started</th><th>Took</th><th>Ended because</th></tr></thead>
      <tbody>${job.attempts.map(
        (attempt) => html`<tr key=${attempt.number}>
          <td data-label="#">${attempt.number}</td><td data-label="Worker"><span>${attempt.worker}${attempt.details.allocation && html`<br /><span class="facts">${allocated(attempt.details.allocation)}</span>`}${attempt.details.gpus?.includes(",") && html`<br /><span class="facts">on ${attempt.details.gpus}</span>`}</span></td><td data-label="Device"><span>${attempt.device || "–"}${memory(attempt)}</span></td>
          <td data-label="Engine">${attempt.engine || "–"}</td><td data-label="Started">${moment(attempt.started_at)}</td>
          <td data-label="Took">${duration(seconds(attempt.started_at, attempt.ended_at || Date.now()))}</td>
          <td data-label="Ended because">${attempt.reason ? html`<span>${attempt.reason}: <${Prose} text=${attempt.message || ""} /></span>` : "still running"}</td>
        </tr>`,
      )}</tbody>
    </table>
  </div></section>`;
}
