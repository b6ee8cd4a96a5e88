/** Every trial: the best first, with boxes to pick some for comparison. */

import { get } from "../../lib/api.js";
import { compact, value } from "../../lib/format.js";
import { html } from "../../lib/html.js";
import { useInSight } from "../../lib/in_sight.js";
import { newest } from "../../lib/job.js";
import { href } from "../../lib/route.js";
import { axesOf, byObjective, hasJob, hasVideos, objectivesOf, told } from "../../lib/sweep.js";
import { Sparkline, Status, Thumbnail } from "../../parts/job_row.js";

export function Trials({ sweep, objective, picked, pick }) {
  const [axes, objectives] = [axesOf(sweep), objectivesOf(sweep)];
  const hasLineage = Boolean(sweep.spec.population);
  const best = new Set(sweep.best.map((trial) => trial.number));
  return html`<section class="card"><h2>Trials</h2>
    ${!sweep.trials.length && html`<p class="facts">None has begun; the first ones begin within seconds.</p>`}
    ${sweep.trials.length > 0 && html`<div class="table trials" tabindex="0" role="region" aria-label="Trials"><table>
      <thead><tr><th>Compare</th><th>Trial</th><th>Curve</th>${hasVideos(sweep) && html`<th>Video</th>`}
        ${hasLineage && html`<th class="number">Generation</th><th>Resumed from</th>`}<th>Status</th>
        ${objectives.map(({ metric }) => html`<th class="number">${metric}</th>`)}
        ${axes.map((axis) => html`<th class="number">${axis}</th>`)}<th class="number">Steps</th></tr></thead>
      <tbody>${byObjective(sweep, objective).map((trial) => html`<tr key=${trial.number} class=${best.has(trial.number) ? "best" : ""}>
        <td>${trial.job && html`<label class="pick"><input type="checkbox" checked=${picked.includes(trial.number)}
          onChange=${() => pick(trial.number)} aria-label="Compare trial ${trial.number}" /></label>`}</td>
        <td>${trial.job ? html`<a href=${href(["jobs", trial.job])}>trial ${trial.number}</a>` : `trial ${trial.number}`}</td>
        <td>${hasJob(trial) && html`<${Sparkline} key=${objective} job=${trial.job} metrics=${[objectives[objective].metric]} step=${trial.step}
          isOver=${isOver(trial)} name="Trial ${trial.number}" />`}</td>
        ${hasVideos(sweep) && html`<td>${hasJob(trial) && html`<${Poster} trial=${trial} />`}</td>`}
        ${hasLineage && html`<td class="number">${trial.generation}</td><td>${trial.parent !== null && `trial ${trial.parent}`}</td>`}
        <td><${Status} job=${trial} />${trial.status !== "succeeded" && trial.message && html`<p class="facts">${trial.message}</p>`}</td>
        ${objectives.map((_, at) => html`<td class="number">${value(trial.values[at])}</td>`)}
        ${axes.map((axis) => html`<td class="number">${told(trial.parameters[axis])}</td>`)}
        <td class="number">${compact(trial.step)}</td>
      </tr>`)}</tbody>
    </table></div>`}
  </section>`;
}

const isOver = (trial) => trial.finished_at !== null;

/** Of the newest video, as soon as there is one. */
function Poster({ trial }) {
  const version = trial.status === "queued" ? "" : `${trial.status} ${trial.step}`;
  const [place, job] = useInSight(() => get(`/jobs/${trial.job}`), version, isOver(trial));
  return html`<div class="poster" ref=${place}>${job && newest(job, "poster") && html`<${Thumbnail} job=${job} />`}</div>`;
}
