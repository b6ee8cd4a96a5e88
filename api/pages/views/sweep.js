/** One sweep: the best so far, what matters, how settings and results lie together, and every trial. */

import { get, post } from "../lib/api.js";
import { ago, duration, seconds } from "../lib/format.js";
import { isFinal } from "../lib/events.js";
import { html, useState } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { change, href, useTitle } from "../lib/route.js";
import { mayChange } from "../lib/session.js";
import { byObjective, chosenObjective, isOver, objectivesOf, title } from "../lib/sweep.js";
import { About, Edit } from "../parts/about.js";
import { Confirm, Copy, Failure, Loading } from "../parts/elements.js";
import { Status } from "../parts/job_row.js";
import { whose } from "../parts/whose.js";
import { Front } from "./sweep/front.js";
import { BestSoFar, Importance } from "./sweep/results.js";
import { Groups } from "./sweep/groups.js";
import { Parallel } from "./sweep/parallel.js";
import { Resume } from "./sweep/resume.js";
import { Trials } from "./sweep/trials.js";

const MOST_COMPARED = 20;

export default function Sweep({ path, query }) {
  const [id] = path;
  const { data: sweep, error, again } = useLive(
    (signal) => get(`/sweeps/${encodeURIComponent(id)}`, {}, { signal }),
    [id],
    (found) => (isOver(found) ? 0 : 2000),
  );
  useTitle(sweep ? headline(sweep) : "Sweep");
  if (!sweep) return error ? html`<${Failure} error=${error} again=${again} />` : html`<${Loading} what="the sweep" />`;
  const objective = chosenObjective(sweep, query);
  const picked = query.getAll("pick").map(Number);
  const pick = (number) =>
    change({ pick: picked.includes(number) ? picked.filter((one) => one !== number) : [...picked, number] }, true);
  return html`<div class="stack">
    <${Head} sweep=${sweep} objective=${objective} again=${again} />
    ${error && html`<${Failure} error=${error} again=${again} />`}
    <${Resume} key=${sweep.status} sweep=${sweep} again=${again} />
    <${Choice} sweep=${sweep} objective=${objective} />
    <div class="halves">
      <${BestSoFar} sweep=${sweep} objective=${objective} />
      <${Importance} sweep=${sweep} />
    </div>
    <${Front} sweep=${sweep} query=${query} />
    <${Parallel} sweep=${sweep} picked=${picked} />
    <${Groups} sweep=${sweep} objective=${objective} />
    <${Trials} sweep=${sweep} objective=${objective} picked=${picked} pick=${pick} />
    <details><summary>Specification</summary><${Copy} text=${JSON.stringify(sweep.spec, null, 2)} name="The sweep as JSON" /></details>
    ${picked.length > 0 && html`<${Picked} sweep=${sweep} picked=${picked} />`}
  </div>`;
}

/** How the sweep goes, and its name, in a few words. */
function headline(sweep) {
  if (isOver(sweep)) return `${sweep.status} ${title(sweep)}`;
  const ended = sweep.trials.filter((trial) => isFinal(trial.status)).length;
  return `${ended}/${sweep.max_trials} ${title(sweep)}`;
}

function Head({ sweep, objective, again }) {
  const [refusal, setRefusal] = useState(null);
  const [isEdited, setEdited] = useState(false);
  const cancel = () => post(sweep.links.cancel).then(again, setRefusal);
  const counted = Object.entries(sweep.num_trials).map(([status, number]) => `${number} ${status}`).join(", ");
  const best = byObjective(sweep, objective).filter((trial) => trial.job).slice(0, 5);
  return html`<div>
    <div class="title">
      <h1>${title(sweep)}</h1>
      <span class="actions">
        ${best.length > 1 && html`<a class="button" href=${compared(best)}>Curves of the best ${best.length}</a>`}
        <a class="button" href=${href(["sweeps", "new"], { again: sweep.id })}>Start one like it</a>
        ${mayChange(sweep) && html`<button type="button" aria-expanded=${isEdited} onClick=${() => setEdited(!isEdited)} title="Its name, labels and note">Edit</button>`}
        ${sweep.status === "running" && html`<${Confirm} text="Cancel" question="Cancel the sweep and its trials?" isDangerous onYes=${cancel} />`}
      </span>
    </div>
    <div class="about-job">
      <${Status} job=${sweep} />
      <span class="facts">${counted || "no trial yet"}, of ${sweep.max_trials} at most · ${sweep.spec.method} · began ${ago(sweep.created_at)}${sweep.finished_at ? `, took ${duration(seconds(sweep.created_at, sweep.finished_at))}` : ""}${whose(sweep)}</span>
      <a href=${href(["jobs"], { sweep: sweep.id })}>Its jobs</a>
    </div>
    ${isEdited ? html`<${Edit} what="sweep" job=${sweep} onEnd=${(isSaved) => (setEdited(false), isSaved && again())} />` : html`<${About} job=${sweep} />`}
    ${sweep.message && html`<p class="message ${sweep.status}">${sweep.message}</p>`}
    ${refusal && html`<${Failure} error=${refusal} />`}
  </div>`;
}

/** Of several objectives, the one that the pictures and the order of the trials are about. */
function Choice({ sweep, objective }) {
  const objectives = objectivesOf(sweep);
  if (objectives.length < 2) return null;
  return html`<div class="tools">
    <label>Objective of what follows
      <select value=${objectives[objective].metric} onChange=${(event) => change({ objective: event.target.value }, true)}>
        ${objectives.map(({ metric, direction }) => html`<option value=${metric}>${metric}, ${direction}</option>`)}
      </select>
    </label>
  </div>`;
}

const compared = (trials) =>
  href(["compare"], { ids: trials.map((trial) => trial.job).filter(Boolean).slice(0, MOST_COMPARED).join(",") });

const Picked = ({ sweep, picked }) => html`<div class="picked" role="status">
  <span>${picked.length} picked</span>
  <a class="button" href=${compared(sweep.trials.filter((trial) => picked.includes(trial.number)))}>Compare</a>
  <button type="button" class="plain" onClick=${() => change({ pick: [] }, true)}>Clear</button>
</div>`;
