/** A job's status, progress and labels. */

import { compact, count, duration } from "../lib/format.js";
import { html } from "../lib/html.js";
import { isOver } from "../lib/job.js";

export const Status = ({ job }) => html`<span class="status ${job.status}">${job.status}</span>`;

// A job's phases besides the steps that its progress counts.
const PHASES = { preparing: "prepares", compiling: "compiles", evaluating: "evaluates", drawing: "draws the video" };

/** What the job does now, unless the steps say it. */
export const phaseOf = (job) => PHASES[job.progress.phase];

/** Steps, speed and the time that is left; before the first step what is done for it. */
export function Progress({ job }) {
  const { step, total, steps_per_second: speed, eta_s: eta } = job.progress;
  const isGoing = !isOver(job) && job.status !== "queued";
  const phase = isGoing && phaseOf(job);
  if (!total) return phase ? html`<span class="facts">${phase}…</span>` : null;
  const isMoving = isGoing && phase !== PHASES.drawing;
  return html`<div class="progress">
    ${isGoing && html`<progress max=${total} value=${step} aria-label="Progress of ${job.name || job.id}"></progress>`}
    <span class="facts" title="${count(step)} of ${count(total)} steps">
      ${compact(step)} of ${compact(total)} steps
      ${isMoving && speed ? ` · ${compact(speed)}/s` : ""}${isMoving && eta ? ` · ${duration(eta)} left` : ""}${phase ? ` · ${phase}…` : ""}
    </span>
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
