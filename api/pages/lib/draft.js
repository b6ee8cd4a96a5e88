/** A job that is being written, a document that has only what was said; and its submission, once at a time. */

import { get, send } from "./api.js";
import { useEffect, useRef, useState } from "./html.js";
import { algorithmOf, environmentOf, optionsOf, title } from "./job.js";

/** The value at a path, or undefined. */
export const at = (document, path) => path.reduce((part, name) => part?.[name], document);

/** The document with a value at a path; undefined removes it, and what becomes empty by that. */
export function put(document, [name, ...rest], value) {
  const copy = Array.isArray(document) ? [...document] : { ...document };
  if (rest.length) {
    const inner = put(typeof copy[name] === "object" && copy[name] !== null ? copy[name] : {}, rest, value);
    // The items of a list keep their places, and those that say nothing stay.
    if (Array.isArray(copy) || Object.keys(inner).length) copy[name] = inner;
    else delete copy[name];
  } else if (value === undefined) delete copy[name];
  else copy[name] = value;
  return copy;
}

/** A job's document as forms write it. */
export function jobOf({ environment, ...job }) {
  const options = optionsOf({ environment });
  return { kind: "train", ...job, environment: { id: environmentOf({ environment }), ...(Object.keys(options).length && { options }) } };
}

/** What text stands for: a document that has an `environment`. Raises an Error with a sentence. */
export function readJob(text) {
  const job = parsed(text);
  if (!job?.environment) throw new Error("This is no job: a job has an `environment`.");
  return jobOf(job);
}

/** The value that text is as JSON. Raises an Error with a sentence. */
export function parsed(text) {
  try {
    return JSON.parse(text);
  } catch (error) {
    throw new Error(`This is not JSON: ${error.message}`);
  }
}

/**
 * The draft that an address asks for: a `job` as JSON, or `from` a job, a `fork` or a `roll` of a checkpoint (with `step`), a `roll` of
 * the best policy (`which`), each of one `seed` of several, or of an `environment` and a `model`.
 */
export async function fromAddress(query) {
  const source = query.get("from") || query.get("fork") || query.get("roll");
  if (query.get("job")) return readJob(query.get("job"));
  if (!source) {
    const environment = { id: query.get("environment") || "ant" };
    if (query.get("model")) environment.options = { model: query.get("model") };
    return { kind: "train", environment };
  }
  const job = await get(`/jobs/${encodeURIComponent(source)}`);
  const environment = { id: environmentOf(job.spec) };
  if (Object.keys(optionsOf(job.spec)).length) environment.options = optionsOf(job.spec);
  const checkpoint = { job: job.id, step: Number(query.get("step")) };
  if (query.get("roll")) {
    const chosen = query.get("which") === "best" ? { job: job.id, which: "best" } : checkpoint;
    if (query.get("seed")) chosen.seed = Number(query.get("seed"));
    return { kind: "rollout", name: `${title(job)}, rolled out`, environment, policy: { kind: "checkpoint", ...chosen } };
  }
  const { note, ...spec } = job.spec; // It is about that run.
  const draft = { ...spec, environment };
  return query.get("fork") ? { ...further(draft, job, checkpoint.step), name: `${title(job)}, forked`, resume_from: checkpoint } : draft;
}

/** The draft with a budget that a checkpoint leaves to train: steps count from the first job's begin. */
function further(draft, job, step) {
  if (algorithmOf(job) === "q_learning") return draft; // It counts episodes.
  const budget = draft.algorithm?.num_timesteps ?? job.progress.total;
  return budget && step >= budget ? put(draft, ["algorithm", "num_timesteps"], step + budget) : draft;
}

/**
 * @param {() => Promise<void>} send Rejects with the service's refusal.
 * @param {object} document What is sent.
 * @returns problem (the last refusal or null), errors (its places whose values have not been changed since),
 *   setProblem, isBusy, reset, and submit, the form's listener. A form that was sent stays busy, since its view is
 *   left; `reset` makes one that stays ready for the next.
 */
export function useSubmission(send, document) {
  const [problem, setProblem] = useState(null);
  const [sent, setSent] = useState(null);
  const [isBusy, setBusy] = useState(false);
  const submit = async (event) => {
    event.preventDefault();
    setBusy(true);
    setSent(document);
    try {
      await send();
    } catch (refusal) {
      setProblem(refusal);
      setBusy(false);
    }
  };
  const reset = () => (setBusy(false), setProblem(null));
  const isAsSent = ({ pointer }) => isSame(valueAt(sent, pointer), valueAt(document, pointer));
  return { problem, errors: (problem?.errors || []).filter(isAsSent), setProblem, isBusy, reset, submit };
}

const SETTLE_MS = 500;

/**
 * What the service says to a document that has not changed for a while; nothing before the first change.
 * @param {string} path Where it checks such documents, and stores nothing.
 * @returns {{isChecked: boolean, problem: Error | null, errors: object[]}} isChecked: whether it took or refused
 *   the document as it is now. errors: the last refusal's places whose values have not changed since.
 */
export function useCheck(path, document) {
  const first = useRef(document);
  const [answer, setAnswer] = useState({});
  useEffect(() => {
    if (document === first.current) return undefined;
    const control = new AbortController();
    const timer = setTimeout(async () => {
      try {
        await send(path, { method: "POST", body: JSON.stringify(document), type: "application/json", signal: control.signal });
        setAnswer({ of: document, problem: null });
      } catch (problem) {
        if (!control.signal.aborted) setAnswer({ of: document, problem });
      }
    }, SETTLE_MS);
    return () => {
      clearTimeout(timer);
      control.abort();
    };
  }, [document]);
  const isAsAsked = ({ pointer }) => isSame(valueAt(answer.of, pointer), valueAt(document, pointer));
  return { isChecked: answer.of === document, problem: answer.problem || null, errors: (answer.problem?.errors || []).filter(isAsAsked) };
}

/** The value at a JSON pointer. */
const valueAt = (document, pointer) =>
  at(document, pointer.split("/").slice(1).map((name) => name.replaceAll("~1", "/").replaceAll("~0", "~")));

const isSame = (one, other) => JSON.stringify(one) === JSON.stringify(other);
