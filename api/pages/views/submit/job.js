/** The form's part about the job: its fields, its errors, and the same as code. */

import { get } from "../../lib/api.js";
import { at, put } from "../../lib/draft.js";
import { html, useEffect, useId, useRef, useState } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { Copy, Failure, Prose } from "../../parts/elements.js";
import { Field } from "../../parts/field.js";
import { AlgorithmPart, EnvironmentPart } from "./environment.js";
import { Notify } from "./notify.js";

const FIRST = ["name", "labels", "note", "seed"];
const PLACED = new Set([...FIRST, "notify", "project", "kind", "environment", "algorithm", "policy"]);

/**
 * change: gets a function from the job's document to the next one. environment: what `useEnvironment` returns.
 * project: whose webhooks it may name. Children: further fields about it.
 */
export function JobFields({ all, document, change, errors, environments, environment, project, children }) {
  const set = (path, value) => change((before) => put(before, path, value));
  const fields = { all, document, set, errors };
  const schema = all[document.kind === "rollout" ? "RolloutSpec" : "TrainSpec"];
  const rest = Object.keys(schema.properties).filter((name) => !PLACED.has(name));
  const draw = (name) => html`<${Field} key=${name} ...${fields} path=${[name]} schema=${schema.properties[name]} />`;
  return html`
    <${Kind} document=${document} change=${change} />
    <${EnvironmentPart} ...${fields} environments=${environments} environment=${environment.data} problem=${environment.error} />
    ${document.kind === "rollout"
      ? html`<fieldset><legend>Policy</legend><${Field} ...${fields} path=${["policy"]} schema=${schema.properties.policy} isOpen /></fieldset>`
      : html`<${AlgorithmPart} ...${fields} schema=${schema.properties.algorithm} environment=${environment.data} />`}
    <fieldset><legend>About it</legend><div class="fields">${FIRST.map(draw)}${children}
      <${Notify} ...${fields} project=${project} schema=${schema.properties.notify} /></div></fieldset>
    <fieldset><legend>Everything else</legend><div class="fields">${rest.map(draw)}</div></fieldset>
  `;
}

function Kind({ document, change }) {
  const choose = (kind) => () =>
    change(({ environment, name, labels, note, seed, project, notify }) => {
      const said = { environment, name, labels, note, seed, project, notify };
      const kept = Object.fromEntries(Object.entries(said).filter(([, value]) => value !== undefined));
      return kind === "train" ? { kind, ...kept } : { kind, ...kept, policy: { kind: "random" } };
    });
  return html`<fieldset><legend>Kind</legend><div class="tools">
    ${[["train", "Train a policy"], ["rollout", "Roll a policy out"]].map(
      ([kind, text]) => html`<label class="inline"><input type="radio" name="kind" checked=${document.kind === kind} onChange=${choose(kind)} /> ${text}</label>`,
    )}
  </div></fieldset>`;
}

// Characters that an address may have of them; of longer ones, the model is what counts here.
const LONGEST_OPTIONS = 5000;

/** The chosen environment under the chosen options, with the defaults that fit it. */
export function useEnvironment(chosen) {
  const id = at(chosen, ["id"]);
  const options = JSON.stringify(at(chosen, ["options"]) || {});
  const [settled, setSettled] = useState(options);
  useEffect(() => {
    const timer = setTimeout(() => setSettled(options), 400);
    return () => clearTimeout(timer);
  }, [options]);
  const model = at(chosen, ["options", "model"]);
  const asked = settled.length > LONGEST_OPTIONS ? JSON.stringify({ model }) : settled;
  const found = useLive((signal) => get(`/environments/${id}`, asked === "{}" ? {} : { options: asked }, { signal }), [id, asked]);
  // While options are wrong, or asked about, the last right ones tell of the model's parts.
  const last = useRef({});
  if (found.data) last.current = { id, model, data: found.data };
  const isOfThis = last.current.id === id && last.current.model === model;
  return isOfThis ? { ...found, data: last.current.data } : found;
}

const FORMS = { JSON: (document) => JSON.stringify(document, null, 2), curl: asCurl, Python: asPython };
// Where it is sent; and the client's calls.
const KINDS = {
  job: { path: "/jobs", submit: "submit", wait: "wait" },
  sweep: { path: "/sweeps", submit: "sweep", wait: "wait_for_sweep" },
};

/** what: `job` or `sweep`. */
export function AsCode({ document, what = "job" }) {
  const [form, setForm] = useState("JSON");
  return html`<section class="card" aria-label="As code">
    <div class="tools" role="group" aria-label="Form">
      ${Object.keys(FORMS).map((name) => html`<button type="button" aria-pressed=${name === form} onClick=${() => setForm(name)}>${name}</button>`)}
    </div>
    <${Copy} text=${FORMS[form](document, what)} name="The submission as ${form}" />
  </section>`;
}

/** A shell's single quotes end where the text has one. */
function asCurl(document, what) {
  const body = JSON.stringify(document, null, 2).replaceAll("'", `'\\''`);
  return `curl -X POST ${location.origin}${KINDS[what].path} \\\n  -H 'Content-Type: application/json' \\\n  -d '${body}'`;
}

function asPython(document, what) {
  const { submit, wait } = KINDS[what];
  return [
    "from gaitway import Client",
    "",
    `with Client("${location.origin}") as client:`,
    `    ${what} = client.${submit}(${literal(document, "    ")})`,
    `    print(client.${wait}(${what}.id).status)`,
  ].join("\n");
}

/** A JSON value as a Python literal. */
export function literal(value, indent = "") {
  if (value === null) return "None";
  if (value === true) return "True";
  if (value === false) return "False";
  if (typeof value !== "object") return JSON.stringify(value);
  if (Array.isArray(value)) return `[${value.map((one) => literal(one, indent)).join(", ")}]`;
  const inner = `${indent}    `;
  const lines = Object.entries(value).map(([name, one]) => `${inner}${JSON.stringify(name)}: ${literal(one, inner)},`);
  return lines.length ? `{\n${lines.join("\n")}\n${indent}}` : "{}";
}

/** A text field for JSON. take: gets the text; it may raise an Error with a sentence. */
export function Pasted({ label, take }) {
  const id = useId();
  const [text, setText] = useState("");
  const [error, setError] = useState(null);
  const press = () => {
    try {
      take(text);
      setError(null);
    } catch (refusal) {
      setError(refusal);
    }
  };
  return html`<div class="field">
    <label for=${id}>${label}</label>
    <textarea id=${id} rows="6" value=${text} onInput=${({ target }) => setText(target.value)} spellcheck="false"></textarea>
    <p class="actions"><button type="button" onClick=${press}>Take it</button></p>
    ${error && html`<${Failure} error=${error} />`}
  </div>`;
}

/** What the service says to the job as it is written. check: what `useCheck` returns. */
export function Checked({ check: { isChecked, problem, errors } }) {
  const isRefused = problem && errors.length > 0;
  return html`<div role="status" class="facts">
    ${isRefused && html`<p class="error">The service would refuse this:</p><ul>${errors.map(({ pointer, detail }) => html`<li key=${pointer}><code>${pointer}</code> <${Prose} text=${detail} /></li>`)}</ul>`}
    ${isChecked && problem && !problem.errors?.length && html`<p><${Prose} text=${problem.message} /></p>`}
    ${isChecked && !problem && html`<p>Checked: the service would take this.</p>`}
  </div>`;
}

export const Errors = ({ problem, errors, box }) =>
  html`<div class="failure" role="alert" tabindex="-1" ref=${box}>
    <h2>It was not submitted</h2>
    ${problem.errors?.length
      ? html`<ul>${errors.map(({ pointer, detail }) => html`<li key=${pointer}><code>${pointer}</code> <${Prose} text=${detail} /></li>`)}</ul>
          ${!errors.length && html`<p>All that was refused has been changed since.</p>`}`
      : html`<p><${Prose} text=${problem.message} /></p>`}
  </div>`;
