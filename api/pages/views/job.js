/** One job: its head, and the tab that the address names. */

import { everyItem, get, post, remove } from "../lib/api.js";
import { duration, moment, seconds } from "../lib/format.js";
import { html, useState } from "../lib/html.js";
import { useCurrentInSight } from "../lib/in_sight.js";
import { algorithmOf, environmentOf, isOver, ofSeed, seedsOf, title, whyQueued } from "../lib/job.js";
import { useLive } from "../lib/live.js";
import { useJob } from "../lib/live_job.js";
import { change, go, href, useTitle } from "../lib/route.js";
import { mayChange } from "../lib/session.js";
import { About, Edit } from "../parts/about.js";
import { Confirm, Empty, Failure, Loading, Prose } from "../parts/elements.js";
import { Progress, Status } from "../parts/job_row.js";
import { whose } from "../parts/whose.js";
import { CurvesTab } from "./job/curves.js";
import { FilesTab } from "./job/files.js";
import { LogTab } from "./job/log.js";
import { OverviewTab } from "./job/overview.js";
import { PushTab } from "./job/push.js";
import { ReplayTab, canDrive, canPush } from "./job/replay.js";
import { SpecificationTab } from "./job/specification.js";

const TABS = {
  overview: ["Overview", OverviewTab],
  replay: ["Replay", ReplayTab],
  push: ["Push", PushTab],
  curves: ["Curves", CurvesTab],
  log: ["Log", LogTab],
  files: ["Files", FilesTab],
  specification: ["Specification", SpecificationTab],
};

// The tabs that show files of one of several seeds.
const OF_A_SEED = ["overview", "replay", "push"];

export default function JobView({ path: [id, tab = "overview"], query }) {
  const live = useJob(id);
  const { job, error, isGone, again } = live;
  const tabs = useCurrentInSight(tab, Boolean(job));
  useTitle(job ? headline(job) : "Job", tab !== "overview" && TABS[tab]?.[0]);
  if (isGone) return html`<${Empty}><p>Somebody deleted this job.</p><p><a href="#/jobs">To the jobs</a></p><//>`;
  if (!job && error) return html`<${Failure} error=${error} again=${again} /><p><a href="#/jobs">To the jobs</a></p>`;
  if (!job) return html`<${Loading} what="the job" />`;
  const Tab = (TABS[tab] || TABS.overview)[1];
  const shown = query.has("seed") ? ofSeed(job, Number(query.get("seed"))) : ofSeed(job);
  return html`
    <${Head} job=${job} again=${again} isBrief=${tab !== "overview"} />
    <nav class="tabs" aria-label="Parts of the job" ref=${tabs}>
      ${Object.entries(TABS).filter(([name]) => name !== "push" || tab === "push" || canPush(shown)).map(
        ([name, [text]]) => html`<a href=${href(["jobs", id, name], { seed: query.get("seed") })} aria-current=${name === tab ? "page" : undefined}>${name === "push" && canDrive(shown) ? "Drive" : text}</a>`,
      )}
    </nav>
    ${OF_A_SEED.includes(tab) && html`<${Seeds} job=${shown} />`}
    <${Tab} ...${live} job=${tab === "files" ? job : shown} query=${query} />
  `;
}

/** Which of several seeds is shown. */
function Seeds({ job }) {
  const seeds = seedsOf(job);
  if (!seeds.length) return null;
  return html`<p><label class="inline">Seed
    <select value=${job.shownSeed} onChange=${(event) => change({ seed: event.target.value })}>${seeds.map((seed) => html`<option key=${seed} value=${seed}>${seed}</option>`)}</select>
  </label> <span class="facts">of ${seeds.length} that are trained together; curves are their mean</span></p>`;
}

/** How the job goes, and its name, in a few words. */
function headline(job) {
  const { step, total } = job.progress;
  if (job.status === "running" && total) return `${Math.floor((100 * step) / total)} % ${title(job)}`;
  return `${job.status} ${title(job)}`;
}

/** isBrief: on a phone, without what the overview says. */
function Head({ job, again, isBrief }) {
  const [problem, setProblem] = useState(null);
  const [isEdited, setEdited] = useState(false);
  const act = (action) => async () => {
    setProblem(null);
    try {
      await action();
    } catch (error) {
      setProblem(error);
    }
  };
  const cancel = act(async () => (await post(job.links.cancel), again()));
  const discard = act(async () => (await remove(job.links.self), go(["jobs"])));
  const environment = environmentOf(job.spec);
  return html`
    <div class="title">
      <h1>${title(job)}</h1>
      <div class="actions scrolling">
        <a class="button quiet" href=${href(["submit"], { from: job.id })}>Run again</a>
        <a class="button quiet" href=${href(["sweeps", "new"], { from: job.id })}>Sweep over these settings</a>
        <a class="button quiet" href=${job.links.report} target="_blank" rel="noopener" title="A report as one HTML file">Share</a>
        <a class="button quiet" href=${job.links.export} download=${`${job.id}.zip`} title="All that is needed to run it again elsewhere, as a zip">Export</a>
        ${mayChange(job) && html`<button type="button" aria-expanded=${isEdited} onClick=${() => setEdited(!isEdited)} title="Its name, labels and note">Edit</button>`}
        ${!isOver(job) && html`<${Confirm} text="Cancel" question="Stop it, and keep its work so far?" onYes=${cancel} />`}
        ${isOver(job) && html`<${Confirm} text="Delete" question="Delete the job and its files for good?" onYes=${discard} isDangerous />`}
      </div>
    </div>
    <div class="about-job ${isBrief ? "brief" : ""}">
      <${Status} job=${job} />
      <span class="facts">${job.kind} · <a href=${href(["jobs"], { environment })}>${environment}</a>${algorithmOf(job) ? ` · ${algorithmOf(job)}` : ""}${whose(job)} · ${job.id}</span>
      <span class="facts"><time datetime=${job.created_at} title=${moment(job.created_at)}>${times(job)}</time></span>
      <${Origin} job=${job} />
      <${Progress} job=${job} />
    </div>
    ${isEdited ? html`<${Edit} what="job" job=${job} onEnd=${(isSaved) => (setEdited(false), isSaved && again())} />` : html`<${About} job=${job} />`}
    ${problem && html`<${Failure} error=${problem} />`}
    <${Message} job=${job} />
  `;
}

function Origin({ job }) {
  if (!job.imported_from) return null;
  const { job: id, version, imported_at: time } = job.imported_from;
  return html`<span class="facts">imported ${moment(time)}: job ${id} of a service with Gaitway ${version}</span>`;
}

function Message({ job }) {
  if (job.status === "queued") return html`<${Waits} job=${job} />`;
  if (!job.message || job.status === "succeeded") return null;
  return html`<p class="message ${job.status}">${job.reason}: <${Prose} text=${job.message} /></p>`;
}

/** Why it waits, and when it should start. */
function Waits({ job }) {
  const { data } = useLive((signal) => Promise.all([everyItem("/workers", { signal }), get(`/jobs/${job.id}`, {}, { signal })]), [job.id], 3000);
  if (!data) return job.waiting_for && html`<p class="message" role="status">It waits. ${job.waiting_for}</p>`;
  const [workers, now] = data;
  const starts = !now.waiting_for && now.turn?.starts_at;
  return html`<p class="message" role="status">It waits. <${Prose} text=${whyQueued(now, workers)} />
    ${starts && new Date(starts) > Date.now() && ` By how long jobs took of late, it starts at about ${moment(starts)}.`} <a href="#/workers">The queue</a></p>`;
}

function times(job) {
  if (!job.started_at) return `submitted ${moment(job.created_at)}`;
  const waited = duration(seconds(job.created_at, job.started_at));
  if (!job.finished_at) return `started ${moment(job.started_at)}, after ${waited} in the queue`;
  return `ran ${duration(seconds(job.started_at, job.finished_at))}, after ${waited} in the queue; ended ${moment(job.finished_at)}`;
}
