/** A job by a form that is made from the service's own JSON Schemas. */

import { get, post } from "../lib/api.js";
import { fromAddress, put, readJob, useCheck, useSubmission } from "../lib/draft.js";
import { html, useEffect, useRef, useState } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { go, href } from "../lib/route.js";
import { schemas } from "../lib/schemas.js";
import { Failure, Loading } from "../parts/elements.js";
import { ProjectChoice } from "../parts/whose.js";
import { Body } from "./submit/environment.js";
import { AsCode, Checked, Errors, JobFields, Pasted, useEnvironment } from "./submit/job.js";

export default function Submit({ query }) {
  const { data, error, again } = useLive(() => load(query), [query.toString()]);
  if (!data) return error ? html`<${Failure} error=${error} again=${again} />` : html`<${Loading} what="the form" />`;
  return html`<${Form} key=${query.toString()} ...${data} />`;
}

async function load(query) {
  const [all, environments, draft] = await Promise.all([schemas(), get("/environments"), fromAddress(query)]);
  return { all, environments: environments.items, draft };
}

function Form({ all, environments, draft }) {
  const [document, setDocument] = useState(draft);
  const summary = useRef();
  const environment = useEnvironment(document.environment);
  const check = useCheck("/jobs/check", document);
  const { problem, errors: refused, isBusy, submit } = useSubmission(async () => go(["jobs", (await post("/jobs", document)).id]), document);
  const isTold = ({ pointer, detail }) => refused.some((one) => one.pointer === pointer && one.detail === detail);
  const errors = [...refused, ...check.errors.filter((error) => !isTold(error))];
  useEffect(() => problem && summary.current?.focus(), [problem]);
  return html`
    <h1>Submit a job</h1>
    <form class="form" onSubmit=${submit} novalidate>
      <div class="stack">
        ${problem && html`<${Errors} problem=${problem} errors=${refused} box=${summary} />`}
        <${JobFields} all=${all} document=${document} change=${setDocument} errors=${errors} environments=${environments} environment=${environment} project=${document.project}>
          <${ProjectChoice} value=${document.project} errors=${errors} onChange=${(project) => setDocument((before) => put(before, ["project"], project))} />
        <//>
      </div>
      <aside aria-label="Preview">
        <p class="actions"><button class="main" disabled=${isBusy}>${isBusy ? "Submitting…" : "Submit"}</button>
          <a href=${href(["sweeps", "new"], { job: JSON.stringify(document) })}>Sweep over these settings</a>
          <span class="facts">What is left empty takes the value shown in grey.</span></p>
        <${Checked} check=${check} />
        <${Body} environment=${document.environment} />
        <${AsCode} document=${document} />
        <details class="card"><summary>From JSON</summary><${Pasted} label="A job as JSON, which takes the place of this one" take=${(text) => setDocument(readJob(text))} /></details>
      </aside>
    </form>
  `;
}
