/** A sweep by a form: a job, the axes along which its settings vary, and when to stop. */

import { get, post } from "../lib/api.js";
import { put, useSubmission } from "../lib/draft.js";
import { html, useEffect, useRef, useState } from "../lib/html.js";
import { fieldsOf, schemas } from "../lib/schemas.js";
import { useLive } from "../lib/live.js";
import { go } from "../lib/route.js";
import { documentOf, draftFrom, examples } from "../lib/sweep_draft.js";
import { Field } from "../parts/field.js";
import { Failure, Loading } from "../parts/elements.js";
import { ProjectChoice } from "../parts/whose.js";
import { Axes } from "./new_sweep/axes.js";
import { JobPart } from "./new_sweep/job.js";
import { MethodPart, Objectives, Size } from "./new_sweep/method.js";
import { AsCode, Errors, useEnvironment } from "./submit/job.js";

export default function NewSweep({ query }) {
  const { data, error, again } = useLive(() => load(query), [query.toString()]);
  if (!data) return error ? html`<${Failure} error=${error} again=${again} />` : html`<${Loading} what="the form" />`;
  return html`<${Form} key=${query.toString()} ...${data} />`;
}

async function load(query) {
  const [all, environments, draft, given, jobs] = await Promise.all([
    schemas(),
    get("/environments"),
    draftFrom(query),
    examples(),
    get("/jobs", { limit: 100 }),
  ]);
  return { all, environments: environments.items, begun: draft, given, jobs: jobs.items };
}

function Form({ all, environments, begun, given, jobs }) {
  const [draft, setDraft] = useState(begun);
  const summary = useRef();
  const environment = useEnvironment(draft.job.environment);
  const document = documentOf(draft);
  const { problem, errors, setProblem, isBusy, submit } = useSubmission(async () => go(["sweeps", (await post("/sweeps", document)).id]), document);
  const known = fieldsOf(draft.job, all, environment.data);
  const set = (path, value) => setDraft((before) => put(before, path, value));
  const fields = { all, document: draft, set, errors };
  const schema = all.SweepSpec.properties;
  // Of another draft, nothing was refused yet.
  const renew = (next) => (setDraft(next), setProblem(null));
  useEffect(() => problem && summary.current?.focus(), [problem]);
  return html`
    <div class="title"><h1>Start a sweep</h1>
      <p class="facts">A sweep runs one job many times with other settings; each run is a trial, and a job of its own.</p></div>
    <form class="form" onSubmit=${submit} novalidate>
      <div class="stack">
        ${problem && html`<${Errors} problem=${problem} errors=${errors} box=${summary} />`}
        <${JobPart} all=${all} draft=${draft} setDraft=${setDraft} renew=${renew} errors=${fields.errors} environments=${environments} environment=${environment} given=${given} jobs=${jobs} />
        <${Axes} draft=${draft} setDraft=${setDraft} errors=${fields.errors} known=${known} environment=${environment.data} />
        <${MethodPart} ...${fields} />
        <${Objectives} ...${fields} environment=${environment.data} />
        <fieldset><legend>About the sweep</legend><div class="fields">
          ${["name", "labels"].map((name) => html`<${Field} key=${name} ...${fields} path=${[name]} schema=${schema[name]} />`)}
          <${ProjectChoice} value=${draft.project} errors=${errors} onChange=${(project) => set(["project"], project)} />
        </div></fieldset>
      </div>
      <aside aria-label="Preview">
        <${Size} document=${document} known=${known} environment=${environment.data} />
        <p class="actions"><button class="main" disabled=${isBusy}>${isBusy ? "Starting…" : "Start the sweep"}</button>
          <span class="facts">What is left empty takes the value shown in grey.</span></p>
        <${AsCode} document=${document} what="sweep" />
      </aside>
    </form>
  `;
}
