/** A job by a form that is made from the service's own JSON Schemas. */

import { get, post } from "../lib/api.js";
import { at, fromAddress, put } from "../lib/draft.js";
import { html, useEffect, useRef, useState } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { go } from "../lib/route.js";
import { schemas } from "../lib/schemas.js";
import { Field } from "../parts/field.js";
import { Failure, Loading } from "../parts/states.js";
import { AlgorithmPart } from "./submit/algorithm.js";
import { Body } from "./submit/body.js";
import { EnvironmentPart } from "./submit/environment.js";
import { Errors } from "./submit/errors.js";
import { AsCode } from "./submit/code.js";

// Everything else follows in the schema's order, folded.
const FIRST = ["name", "labels", "seed"];
const PLACED = new Set([...FIRST, "kind", "environment", "algorithm", "policy"]);

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
  const [problem, setProblem] = useState(null);
  const [isBusy, setBusy] = useState(false);
  const summary = useRef();
  const environment = useEnvironment(document.environment);
  const set = (path, value) => setDocument((before) => put(before, path, value));
  const errors = problem?.errors || [];
  const fields = { all, document, set, errors };
  const schema = all[document.kind === "train" ? "TrainSpec" : "RolloutSpec"];
  const submit = async (event) => {
    event.preventDefault();
    setBusy(true);
    try {
      const job = await post("/jobs", document);
      go(["jobs", job.id]);
    } catch (refusal) {
      setProblem(refusal);
      setBusy(false);
    }
  };
  useEffect(() => problem && summary.current?.focus(), [problem]);
  return html`
    <h1>Submit a job</h1>
    <form class="form" onSubmit=${submit} novalidate>
      <div class="stack">
        ${problem && html`<${Errors} problem=${problem} box=${summary} />`}
        <${Kind} document=${document} setDocument=${setDocument} />
        <${EnvironmentPart} ...${fields} environments=${environments} environment=${environment.data} problem=${environment.error} />
        ${document.kind === "train"
          ? html`<${AlgorithmPart} ...${fields} schema=${schema.properties.algorithm} environment=${environment.data} />`
          : html`<fieldset><legend>Policy</legend><${Field} ...${fields} path=${["policy"]} schema=${schema.properties.policy} isOpen /></fieldset>`}
        <fieldset><legend>About it</legend>
          <div class="fields">${FIRST.map((name) => html`<${Field} key=${name} ...${fields} path=${[name]} schema=${schema.properties[name]} />`)}</div>
        </fieldset>
        <fieldset><legend>Everything else</legend>
          <div class="fields">
            ${Object.keys(schema.properties).filter((name) => !PLACED.has(name)).map(
              (name) => html`<${Field} key=${name} ...${fields} path=${[name]} schema=${schema.properties[name]} />`,
            )}
          </div>
        </fieldset>
      </div>
      <aside aria-label="Preview">
        <p class="actions"><button class="main" disabled=${isBusy}>${isBusy ? "Submitting…" : "Submit"}</button>
          <span class="facts">What is left empty takes the value shown in grey.</span></p>
        <${Body} environment=${document.environment} />
        <${AsCode} document=${document} />
      </aside>
    </form>
  `;
}

function Kind({ document, setDocument }) {
  const choose = (kind) => () =>
    setDocument(({ environment, name, labels, seed }) => {
      const kept = Object.fromEntries(Object.entries({ environment, name, labels, seed }).filter(([, value]) => value !== undefined));
      return kind === "train" ? { kind, ...kept } : { kind, ...kept, policy: { kind: "random" } };
    });
  return html`<fieldset><legend>Kind</legend><div class="tools">
    ${[["train", "Train a policy"], ["rollout", "Roll a policy out"]].map(
      ([kind, text]) => html`<label class="inline"><input type="radio" name="kind" checked=${document.kind === kind} onChange=${choose(kind)} /> ${text}</label>`,
    )}
  </div></fieldset>`;
}

/** The chosen environment under the chosen options, with the defaults that fit it. */
function useEnvironment(chosen) {
  const id = at(chosen, ["id"]);
  const options = JSON.stringify(at(chosen, ["options"]) || {});
  const [settled, setSettled] = useState(options);
  useEffect(() => {
    const timer = setTimeout(() => setSettled(options), 400);
    return () => clearTimeout(timer);
  }, [options]);
  return useLive((signal) => get(`/environments/${id}`, settled === "{}" ? {} : { options: settled }, { signal }), [id, settled]);
}
