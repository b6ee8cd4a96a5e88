/** Several jobs beside each other: curves, the settings that differ, videos in step. */

import { get } from "../lib/api.js";
import { html, useMemo } from "../lib/html.js";
import { isOver, settingsOf, title } from "../lib/job.js";
import { useLive } from "../lib/live.js";
import { change } from "../lib/route.js";
import { Empty, Failure, Loading } from "../parts/elements.js";
import { Curves } from "./compare/curves.js";
import { Differences } from "./compare/differences.js";
import { FilmsInStep } from "./compare/films.js";

const MOST = 20;
export const COLOURS = 8;

export default function Compare({ query }) {
  const ids = (query.get("ids") || "").split(",").filter(Boolean).slice(0, MOST);
  const { data, error, again } = useLive((signal) => load(ids, signal), [ids.join()], (found) =>
    found.jobs.some((job) => !isOver(job)) ? 4000 : 0,
  );
  // Settings do not change while a job runs, except that an attempt reports what it runs with.
  const started = data?.jobs.map((job) => job.attempts.length).join();
  const settings = useLive(() => Promise.all((data?.jobs || []).map(settingsOf)), [ids.join(), started]);
  const jobs = useMemo(() => named(data?.jobs || []), [data]);
  if (!ids.length) {
    return html`<h1>Compare</h1><${Empty}><p>Pick jobs in <a href="#/jobs">the list</a> by their boxes, then choose “Compare”.</p><//>`;
  }
  if (!data) return error ? html`<${Failure} error=${error} again=${again} />` : html`<${Loading} what="the jobs" />`;
  return html`<div class="stack">
    <div class="title"><h1>Compare ${jobs.length} ${jobs.length === 1 ? "job" : "jobs"}</h1></div>
    ${data.missing.length > 0 && html`<p class="error" role="status">Not there (any more): ${data.missing.join(", ")}</p>`}
    <${Keys} jobs=${jobs} />
    ${jobs.length > 0 && html`
      <${Curves} jobs=${jobs} query=${query} />
      <${Differences} jobs=${jobs} settings=${settings.data} error=${settings.error} />
      <${FilmsInStep} jobs=${jobs} />`}
  </div>`;
}

async function load(ids, signal) {
  const found = await Promise.all(
    ids.map((id) => get(`/jobs/${encodeURIComponent(id)}`, {}, { signal }).catch((error) => {
      if (error.status === 404) return null;
      throw error;
    })),
  );
  return { jobs: found.filter(Boolean), missing: ids.filter((_, i) => !found[i]) };
}

/** Each job with a name of its own and a colour. */
function named(jobs) {
  const names = jobs.map(title);
  return jobs.map((job, i) => ({
    ...job,
    label: names.filter((name) => name === names[i]).length > 1 ? `${names[i]} (${job.id.slice(-4)})` : names[i],
    colour: `--curve-${(i % COLOURS) + 1}`,
    isDashed: i >= COLOURS,
  }));
}

const Keys = ({ jobs }) => {
  const without = (id) => jobs.map((job) => job.id).filter((other) => other !== id).join(",");
  return html`<ul class="keys" aria-label="Jobs that are compared">
    ${jobs.map((job) => html`<li key=${job.id}>
      <svg viewBox="0 0 18 5" aria-hidden="true"><line x1="0" x2="18" y1="2.5" y2="2.5" stroke-width="4" stroke-dasharray=${job.isDashed ? "4 3" : ""} style=${{ stroke: `var(${job.colour})` }} /></svg>
      <a href="#/jobs/${job.id}">${job.label}</a>
      <button type="button" class="label" aria-label="Leave out ${job.label}" onClick=${() => change({ ids: without(job.id) })}>×</button>
    </li>`)}
  </ul>`;
};
