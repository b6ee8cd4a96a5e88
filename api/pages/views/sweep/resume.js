/** Continue an ended sweep under another budget. */

import { post } from "../../lib/api.js";
import { put, useSubmission } from "../../lib/draft.js";
import { html, useState } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { schemas } from "../../lib/schemas.js";
import { Field } from "../../parts/field.js";
import { Failure, Loading } from "../../parts/elements.js";

/** Nothing while it goes on. */
export function Resume({ sweep, again }) {
  const [isOpen, setOpen] = useState(false);
  if (!sweep.links.resume) return null;
  return html`<details class="card" open=${isOpen} onToggle=${(event) => setOpen(event.target.open)}>
    <summary>Resume under another budget</summary>
    ${isOpen && html`<${Form} sweep=${sweep} again=${again} />`}
  </details>`;
}

function Form({ sweep, again }) {
  const { data: all, error, again: retry } = useLive(schemas, []);
  const [document, setDocument] = useState({ budget: said(sweep.spec.budget) });
  const { problem, errors, isBusy, submit } = useSubmission(async () => {
    await post(sweep.links.resume, { budget: {}, ...document });
    again();
  }, document);
  if (!all) return error ? html`<${Failure} error=${error} again=${retry} />` : html`<${Loading} what="the form" />`;
  const steps = sweep.trials.reduce((sum, trial) => sum + trial.step, 0);
  return html`<form class="stack" onSubmit=${submit} novalidate>
    <p class="facts">The budget counts what the sweep has done: ${sweep.trials.length.toLocaleString("en")} trials with ${steps.toLocaleString("en")} steps.
      They stay as they are, and the next trial follows the last.</p>
    <${Field} all=${all} document=${document} errors=${errors} path=${["budget"]} schema=${{ $ref: "Budget" }} isOpen
      set=${(path, value) => setDocument((before) => put(before, path, value))} />
    ${problem && !problem.errors?.length && html`<${Failure} error=${problem} />`}
    <p class="actions"><button class="main" disabled=${isBusy}>${isBusy ? "Resuming…" : "Resume"}</button></p>
  </form>`;
}

/** The limits that the budget has. */
const said = (budget) => Object.fromEntries(Object.entries(budget).filter(([, value]) => value !== null));
