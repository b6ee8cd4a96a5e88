/** The job of a sweep: from an example, from another job, pasted; then changed like any job. */

import { get } from "../../lib/api.js";
import { ago } from "../../lib/format.js";
import { html, useState } from "../../lib/html.js";
import { algorithmOf, environmentOf, title } from "../../lib/job.js";
import { asWritten, draftOf, readDraft } from "../../lib/sweep_draft.js";
import { Failure, Prose } from "../../parts/elements.js";
import { JobFields, Pasted } from "../submit/job.js";

const SOURCES = { example: "An example", job: "Another job", text: "Pasted JSON" };

/** renew: puts another draft in the place of this one; setDraft changes it. */
export function JobPart({ all, draft, setDraft, renew, errors, environments, environment, given, jobs }) {
  const change = (next) => setDraft((before) => ({ ...before, job: next(before.job) }));
  const own = errors.filter(({ pointer }) => /^\/job(\/|$)/.test(pointer)).map((error) => ({ ...error, pointer: error.pointer.slice("/job".length) }));
  const [isOpen, setOpen] = useState(false);
  return html`<fieldset class="part"><legend>Job</legend>
    <p><strong>${environmentOf(draft.job)}</strong>${` · ${algorithmOf({ kind: draft.job.kind, spec: draft.job }) || draft.job.kind}`}${draft.job.name ? ` · ${draft.job.name}` : ""}</p>
    <${Source} draft=${draft} renew=${renew} given=${given} jobs=${jobs} />
    ${own.map(({ pointer, detail }) => html`<p class="error" key=${pointer}><${Prose} text=${detail} /></p>`)}
    <details open=${isOpen || own.length > 0} onToggle=${(event) => setOpen(event.target.open)}>
      <summary>Environment, algorithm and other settings of the job</summary>
      ${(isOpen || own.length > 0) &&
      html`<div class="stack"><${JobFields} all=${all} document=${draft.job} change=${change} errors=${own} environments=${environments} environment=${environment} project=${draft.project} /></div>`}
    </details>
  </fieldset>`;
}

function Source({ draft, renew, given, jobs }) {
  const [source, setSource] = useState("example");
  const [error, setError] = useState(null);
  const choose = (name) => () => (setSource(name), setError(null));
  return html`
    <div class="tools" role="group" aria-label="Where the job comes from">
      ${Object.entries(SOURCES).map(([name, text]) => html`<button type="button" key=${name} aria-pressed=${name === source} onClick=${choose(name)}>${text}</button>`)}
    </div>
    ${source === "example" && html`<${FromExample} given=${given} renew=${renew} />`}
    ${source === "job" && html`<${FromJob} jobs=${jobs} renew=${renew} setError=${setError} />`}
    ${source === "text" && html`<${Pasted} label="A job or a whole sweep, as JSON" take=${(text) => renew(readDraft(text, draft))} />`}
    ${error && html`<${Failure} error=${error} />`}
  `;
}

/** Examples are whole sweeps. */
function FromExample({ given, renew }) {
  const [name, setName] = useState("");
  const take = ({ target }) => {
    setName(target.value);
    if (target.value) renew(draftOf(given[target.value]));
  };
  return html`<div class="field">
    <label for="example">Example of a sweep</label>
    <select id="example" value=${name} onChange=${take}>
      <option value="">Choose one to fill in the whole form</option>
      ${Object.keys(given).map((one) => html`<option key=${one} value=${one}>${one}</option>`)}
    </select>
  </div>`;
}

function FromJob({ jobs, renew, setError }) {
  const [id, setId] = useState("");
  const take = async ({ target }) => {
    setId(target.value);
    setError(null);
    if (!target.value) return;
    try {
      const job = await get(`/jobs/${encodeURIComponent(target.value)}`);
      renew((before) => ({ ...before, job: asWritten(job.spec) }));
    } catch (error) {
      setError(error);
    }
  };
  if (!jobs.length) return html`<p class="facts">There is no job yet. Take an example, or write the settings below.</p>`;
  return html`<div class="field">
    <label for="from-job">Job whose settings to take</label>
    <select id="from-job" value=${id} onChange=${take}>
      <option value="">Choose one of the newest ${jobs.length}</option>
      ${jobs.map((job) => html`<option key=${job.id} value=${job.id}>${title(job)} · ${environmentOf(job.spec)} · ${ago(job.created_at)}</option>`)}
    </select>
    <p class="facts">The axes stay. On an older job's page: “Sweep over these settings”.</p>
  </div>`;
}
