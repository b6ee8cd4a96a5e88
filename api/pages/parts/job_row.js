/** A job in a row of a list: its status, progress, labels, poster and returns. */

import { get } from "../lib/api.js";
import { compact, count, duration, seconds, value } from "../lib/format.js";
import { html } from "../lib/html.js";
import { useInSight } from "../lib/in_sight.js";
import { isOver, newest } from "../lib/job.js";
import { href } from "../lib/route.js";

export const Status = ({ job }) => html`<span class="status ${job.status}">${job.status}</span>`;

// A job's phases besides the steps that its progress counts.
const PHASES = { preparing: "prepares", compiling: "compiles", evaluating: "evaluates", drawing: "draws the video", testing: "tests the policy in C MuJoCo: the battery" };
const SOON_S = 15; // Where its programs were kept, a job trains by then.

/** What the job does now, unless the steps say it. */
function phaseOf(job) {
  const phase = PHASES[job.progress.phase];
  const begun = job.attempts?.at(-1)?.started_at ?? job.started_at;
  const passed = begun ? seconds(begun, Date.now()) : 0;
  if (phase !== PHASES.compiling || passed < SOON_S) return phase;
  return `compiles (started ${duration(passed)} ago); the first time may take minutes, a later start of the same job is shorter`;
}

/** Steps, speed and the time that is left; before the first step what is done for it. */
export function Progress({ job }) {
  const { step, total, steps_per_second: speed, eta_s: eta } = job.progress;
  const isGoing = !isOver(job) && job.status !== "queued";
  const phase = isGoing && phaseOf(job);
  if (!total) return phase ? html`<span class="facts">${phase}…</span>` : null;
  const isMoving = isGoing && ![PHASES.drawing, PHASES.testing].includes(phase);
  return html`<div class="progress">
    ${isGoing && html`<progress max=${total} value=${step} aria-label="Progress of ${job.name || job.id}"></progress>`}
    <span class="facts" title="${count(step)} of ${count(total)} steps">
      ${compact(step)} of ${compact(total)} steps
      ${isMoving && speed ? ` · ${compact(speed)}/s` : ""}${isMoving && eta ? ` · ${duration(eta)} left` : ""}${phase ? ` · ${phase}…` : ""}
    </span>
  </div>`;
}

/** As `Progress`, in a narrow cell, without the speed, which has a column of its own. */
export function Steps({ job }) {
  const { step, total, eta_s: eta } = job.progress;
  const isGoing = !isOver(job) && job.status !== "queued";
  const phase = isGoing && phaseOf(job);
  if (!total) return phase ? html`<span class="facts">${phase}…</span>` : null;
  const isMoving = isGoing && ![PHASES.drawing, PHASES.testing].includes(phase);
  return html`<div class="progress">
    ${isGoing && html`<progress max=${total} value=${step} aria-label="Progress of ${job.name || job.id}"></progress>`}
    <span class="facts" title="${count(step)} of ${count(total)} steps">${compact(step)} of ${compact(total)}${isMoving && eta ? html` · ${duration(eta)} left` : ""}${phase ? ` · ${phase}…` : ""}</span>
  </div>`;
}

/** Labels; each is a link that `hrefOf` makes. */
export const Labels = ({ labels, hrefOf }) => {
  const pairs = Object.entries(labels);
  if (!pairs.length) return null;
  return html`<ul class="labels" aria-label="Labels">
    ${pairs.map(([key, value]) => html`<li key=${key}><a class="label" href=${hrefOf(key, value)}>${key}: ${value}</a></li>`)}
  </ul>`;
};

/** job: its document. Children: what stands there while it has no poster. */
export function Thumbnail({ job, children }) {
  const poster = newest(job, "poster");
  return html`<a class="thumbnail" href=${href(["jobs", job.id])} tabindex="-1" aria-hidden="true">
    ${poster ? html`<img src=${poster.href} alt="" loading="lazy" />` : children}
  </a>`;
}

const WIDTH = 120;
const HEIGHT = 36;

/** The points of the first of these metrics that has some: [[step, value]]. */
async function curve(job, metrics) {
  const { rows } = await get(`/jobs/${job}/metrics`, { points: 60, metric: metrics });
  const name = metrics.find((each) => rows.some((row) => typeof row.values[each] === "number"));
  return rows.filter((row) => typeof row.values[name] === "number").map((row) => [row.step, row.values[name]]);
}

/** The points as SVG coordinates. */
function path(points) {
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const place = (values, one, size) => {
    const [low, high] = [Math.min(...values), Math.max(...values)];
    return high > low ? ((one - low) / (high - low)) * (size - 4) + 2 : size / 2;
  };
  return points.map(([x, y]) => `${place(xs, x, WIDTH).toFixed(1)},${(HEIGHT - place(ys, y, HEIGHT)).toFixed(1)}`).join(" ");
}

/**
 * @param {{job: string, metrics: string[], step: number, isOver: boolean, name: string}} facts
 *   job: its id; step: of its progress, with which the curve grows; name: what the curve is. Children: a caption.
 */
export function Sparkline({ job, metrics, step, isOver, name, children }) {
  const [place, points] = useInSight(() => curve(job, metrics), step, isOver);
  return html`<div class="spark" ref=${place}>
    ${points?.length > 1 &&
    html`<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label="${name}, from ${value(points[0][1])} to ${value(points.at(-1)[1])}">
      <polyline points=${path(points)} />
    </svg>`}
    ${children}
  </div>`;
}
