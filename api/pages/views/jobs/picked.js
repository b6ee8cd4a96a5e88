/** What can be done with the jobs that are chosen: compare, cancel, delete. A dialog says before what will happen. */

import { post } from "../../lib/api.js";
import { html, useEffect, useRef, useState } from "../../lib/html.js";
import { isOver, title } from "../../lib/job.js";
import { change, href } from "../../lib/route.js";

const AT_ONCE = 200; // The service takes so many in one request.
const MOST_NAMED = 8;

const jobs = (number) => (number === 1 ? "1 job" : `${number} jobs`);

/** known: jobs by id, as far as they were seen. again: read the list anew. */
export function Picked({ ids, known, again }) {
  const [act, setAct] = useState(null);
  const clear = () => change({ pick: [] }, true);
  const done = (gone) => {
    change({ pick: ids.filter((id) => !gone.includes(id)) }, true);
    again();
  };
  return html`<div class="picked">
    <span role="status">${ids.length} chosen</span>
    <a class="button quiet" href=${href(["compare"], { ids: ids.join(",") })}>Compare</a>
    <button type="button" onClick=${() => setAct("cancel")}>Cancel…</button>
    <button type="button" class="danger" onClick=${() => setAct("delete")}>Delete…</button>
    <button type="button" class="plain" onClick=${clear}>Clear</button>
    ${act && html`<${Question} key=${act} act=${act} ids=${ids} known=${known} done=${done} close=${() => setAct(null)} />`}
  </div>`;
}

/** Which of them the act is for, and what becomes of all, as sentences. Those that were never seen are tried. */
function plan(act, ids, known) {
  const unseen = ids.filter((id) => !known.has(id));
  const seen = ids.filter((id) => known.has(id)).map((id) => known.get(id));
  const over = seen.filter(isOver);
  const waiting = seen.filter((job) => job.status === "queued");
  const going = seen.filter((job) => !isOver(job) && job.status !== "queued");
  const fit = act === "cancel" ? [...waiting, ...going] : over;
  const say = (list, one, many) => list.length > 0 && (list.length === 1 ? `1 job ${one}` : `${list.length} jobs ${many}`);
  const sentences =
    act === "cancel"
      ? [
          say(waiting, "waits and will never start.", "wait and will never start."),
          say(going, "runs: it saves its checkpoint, policy and video so far, and ends.", "run: each saves its checkpoint, policy and video so far, and ends."),
          say(over, "has ended and stays as it is.", "have ended and stay as they are."),
        ]
      : [
          say(over, "will be gone with all its files: checkpoints, videos, metrics. Nothing brings it back.", "will be gone with all their files: checkpoints, videos, metrics. Nothing brings them back."),
          say([...waiting, ...going], "has not ended and stays: cancel it first.", "have not ended and stay: cancel them first."),
        ];
  sentences.push(say(unseen, "was chosen before this page was loaded, and is tried, too.", "were chosen before this page was loaded, and are tried, too."));
  return { fit: [...fit.map((job) => job.id), ...unseen], named: fit, sentences: sentences.filter(Boolean) };
}

function Question({ act, ids, known, done, close }) {
  const dialog = useRef();
  const [outcomes, setOutcomes] = useState(null);
  const [isBusy, setBusy] = useState(false);
  const [error, setError] = useState(null);
  // As it was when it was asked: the list goes on behind the dialog.
  const [{ fit, named, sentences }] = useState(() => plan(act, ids, known));
  useEffect(() => dialog.current.showModal(), []);
  const run = async () => {
    setBusy(true);
    setError(null);
    const found = [];
    try {
      for (let at = 0; at < fit.length; at += AT_ONCE) found.push(...(await post(`/jobs/${act}`, { jobs: fit.slice(at, at + AT_ONCE) })).items);
    } catch (problem) {
      setError(problem);
    }
    setBusy(false);
    const refused = found.filter(({ result }) => result === "refused");
    if (found.length) done(found.filter(({ result }) => result !== "refused").map(({ job }) => job));
    if (found.length === fit.length && !refused.length) close();
    else if (found.length) setOutcomes({ number: found.length - refused.length, refused });
  };
  const verb = act === "cancel" ? "Cancel" : "Delete";
  const nameOf = (id) => (known.has(id) ? title(known.get(id)) : id);
  return html`<dialog ref=${dialog} class="card" aria-labelledby="question" onClose=${close}>
    <h2 id="question">${outcomes ? `${jobs(outcomes.number)} ${act === "cancel" ? "cancelled" : "deleted"}` : fit.length ? `${verb} ${jobs(fit.length)}?` : `None of these can be ${act === "cancel" ? "cancelled" : "deleted"}`}</h2>
    ${outcomes
      ? html`<ul class="lines">${outcomes.refused.map(({ job, message }) => html`<li key=${job}><strong>${nameOf(job)}</strong>: ${message}</li>`)}</ul>`
      : html`${sentences.map((text) => html`<p key=${text}>${text}</p>`)}
          ${named.length > 0 && html`<p class="facts">${named.slice(0, MOST_NAMED).map(title).join("; ")}${named.length > MOST_NAMED ? `; and ${named.length - MOST_NAMED} more` : ""}</p>`}`}
    ${error && html`<p class="error" role="alert">${error.message}</p>`}
    <div class="actions">
      ${!outcomes && fit.length > 0 && html`<button type="button" class="danger" disabled=${isBusy} onClick=${run}>${isBusy ? "Please wait…" : `${verb} ${jobs(fit.length)}`}</button>`}
      <button type="button" onClick=${() => dialog.current.close()}>${outcomes || !fit.length ? "Close" : "Leave them"}</button>
    </div>
  </dialog>`;
}
