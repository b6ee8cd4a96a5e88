/** What people call a job or a sweep and say of it: labels and note, and a form that changes them and the name. */

import { patch } from "../lib/api.js";
import { useSubmission } from "../lib/draft.js";
import { html, useEffect, useRef, useState } from "../lib/html.js";
import { labelsOf } from "../lib/job.js";
import { href } from "../lib/route.js";
import { Prose } from "./elements.js";
import { Labels } from "./job_row.js";

export const About = ({ job }) => html`
  <${Labels} labels=${labelsOf(job)} hrefOf=${(key, value) => href(["jobs"], { label: `${key}:${value}` })} />
  ${job.note && html`<p class="note" role="note" aria-label="Note">${job.note}</p>`}
`;

const LABEL = /^\s*([\w.-]+)\s*[:=]\s*(.*?)\s*$/;

/** what: `job` or `sweep`, whose document is `job`. onEnd: called once it is saved, with true, or given up, with false. */
export function Edit({ what, job, onEnd }) {
  const [before] = useState(job); // Others may change it meanwhile.
  const [draft, setDraft] = useState({ name: job.name || "", labels: labelsOf(job), note: job.note || "" });
  const [typed, setTyped] = useState("");
  const [first, label] = [useRef(), useRef()];
  useEffect(() => first.current.focus(), []);
  const set = (name) => ({ target }) => setDraft((one) => ({ ...one, [name]: target.value }));
  const labels = withTyped(draft.labels, typed);
  const { problem, isBusy, submit } = useSubmission(async () => {
    await patch(job.links.self, changes(before, { ...draft, labels }));
    onEnd(true);
  }, { ...draft, labels });
  const keep = () => (setDraft((one) => ({ ...one, labels })), setTyped(""), label.current.focus());
  const drop = (key) => () => setDraft(({ labels: { [key]: gone, ...rest }, ...one }) => ({ ...one, labels: rest }));
  const isNoLabel = Boolean(typed.trim()) && !LABEL.test(typed);
  return html`<form class="card stack edit" onSubmit=${submit} novalidate aria-label="Edit the ${what}">
    <label class="field">Name <input value=${draft.name} onInput=${set("name")} maxlength="200" ref=${first} /></label>
    <fieldset class="tools"><legend>Labels</legend>
      ${Object.entries(draft.labels).map(([key, value]) => html`<button key=${key} type="button" class="label" aria-label="Remove the label ${key}: ${value}" onClick=${drop(key)}>${key}: ${value} ×</button>`)}
      <label>One more <input value=${typed} onInput=${({ target }) => setTyped(target.value)} ref=${label} placeholder="key: value" autocapitalize="off"
        aria-invalid=${isNoLabel ? "true" : undefined} aria-describedby=${isNoLabel ? "no-label" : undefined} /></label>
      <button type="button" disabled=${!LABEL.test(typed)} onClick=${keep}>Add it</button>
      ${isNoLabel && html`<p class="facts" id="no-label">A label is a key and a value with a colon between them, such as <code>team: legs</code>.</p>`}
    </fieldset>
    <label class="field">Note <textarea rows="4" value=${draft.note} onInput=${set("note")} maxlength="4000"></textarea></label>
    <p class="actions"><button class="main" disabled=${isBusy || isNoLabel}>Save</button><button type="button" onClick=${() => onEnd(false)}>Leave it as it was</button></p>
    ${problem && html`<p class="error" role="alert"><${Prose} text=${problem.message} /></p>`}
  </form>`;
}

function withTyped(labels, typed) {
  const [, key, value] = LABEL.exec(typed) || [];
  return key ? { ...labels, [key]: value } : labels;
}

/** The JSON merge patch. What others have changed meanwhile stays, unless it was changed here, too. */
function changes(job, { name, labels, note }) {
  const had = labelsOf(job);
  const gone = Object.keys(had).filter((key) => !(key in labels));
  const differ = Object.entries(labels).filter(([key, value]) => had[key] !== value);
  return {
    ...(name !== (job.name || "") && { name: name || null }),
    ...((gone.length > 0 || differ.length > 0) && { labels: { ...Object.fromEntries(differ), ...Object.fromEntries(gone.map((key) => [key, null])) } }),
    ...(note !== (job.note || "") && { note: note || null }),
  };
}
