/** A job's status, progress and labels. */

import { compact, count, duration } from "../lib/format.js";
import { html } from "../lib/html.js";
import { isOver } from "../lib/job.js";

export const Status = ({ job }) => html`<span class="status ${job.status}">${job.status}</span>`;

/** Steps, speed and the time that is left; nothing before the first step. */
export function Progress({ job }) {
  const { step, total, steps_per_second: speed, eta_s: eta } = job.progress;
  const isGoing = !isOver(job) && job.status !== "queued";
  if (!total) return null;
  return html`<div class="progress">
    ${isGoing && html`<progress max=${total} value=${step} aria-label="Progress of ${job.name || job.id}"></progress>`}
    <span class="facts" title="${count(step)} of ${count(total)} steps">
      ${compact(step)} of ${compact(total)} steps
      ${isGoing && speed ? ` · ${compact(speed)}/s` : ""}${isGoing && eta ? ` · ${duration(eta)} left` : ""}
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
