/** Models of users: upload one by dropping it, see what a worker found in it. */

import { get, remove, send, withQuery } from "../lib/api.js";
import { ago, bytes, compact, duration, modelName, value } from "../lib/format.js";
import { html, useRef, useState } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { href } from "../lib/route.js";
import { Confirm, Copy, Empty, Failure, Loading, Pages, Prose, Said } from "../parts/elements.js";
import { ProjectChoice, whose } from "../parts/whose.js";

const LIMIT = 50;
const LONGEST_NAME = 100; // Characters, as the service allows.
const LISTS = ["bodies", "joints", "actuators", "sensors", "cameras", "keyframes"];
const isSettling = (model) => model.status === "validating" || (model.status === "ready" && !model.description?.complete);

export default function Models({ query }) {
  const cursor = query.get("cursor");
  const { data, error, again } = useLive(
    (signal) => get("/models", { cursor, limit: LIMIT }, { signal }),
    [cursor],
    (found) => (found.items.some(isSettling) ? 1500 : 15_000),
  );
  return html`<div class="stack">
    <h1>Models</h1>
    <${Drop} onAdded=${again} />
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data && !error && html`<${Loading} what="models" />`}
    ${data && !data.items.length && !cursor && html`<${Empty}><p>No models yet. A model is a robot of your own, as MJCF or URDF.</p><//>`}
    ${data && html`<div class="grid">${data.items.map((model) => html`<${Model} key=${model.id} model=${model} again=${again} />`)}</div>`}
    ${data && html`<${Pages} path=${["models"]} query=${query} next=${data.next} name="Pages of models" first="Newest" more="Older models" />`}
  </div>`;
}

function Drop({ onAdded }) {
  const [state, setState] = useState({});
  const [isOver, setOver] = useState(false);
  const [main, setMain] = useState("");
  const [project, setProject] = useState();
  const input = useRef();
  const upload = async (file) => {
    if (!file) return;
    setState({ text: `Sending ${file.name} (${bytes(file.size)}); a worker reads it…` });
    try {
      const type = file.name.toLowerCase().endsWith(".zip") ? "application/zip" : "application/xml";
      const path = withQuery("/models", { name: file.name.slice(0, LONGEST_NAME), main: main.trim(), project });
      const model = await (await send(path, { method: "POST", body: file, type })).json();
      const read = model.description?.main;
      const isThere = read && read !== file.name && type.endsWith("zip") ? `is there, read from ${read}.` : "is there.";
      setState({ text: `${file.name} ${model.status === "validating" ? "waits for a worker to read it; a busy one does so after its job." : isThere}` });
    } catch (error) {
      setState({ error, file });
    }
    input.current.value = "";
    onAdded();
  };
  const drop = (event) => {
    event.preventDefault();
    setOver(false);
    upload(event.dataTransfer.files[0]);
  };
  return html`<section class="drop ${isOver ? "over" : ""}" aria-label="Upload a model"
    onDragOver=${(event) => (event.preventDefault(), setOver(true))} onDragLeave=${() => setOver(false)} onDrop=${drop}>
    <label class="field">Drop an MJCF or URDF file here, or a zip with its meshes; or choose one:
      <input ref=${input} type="file" accept=".xml,.mjcf,.urdf,.zip" onChange=${(event) => upload(event.target.files[0])} />
    </label>
    <label class="field">Of a zip with several documents, the one that is the model (such as scene.xml):
      <input value=${main} onInput=${(event) => setMain(event.target.value)} />
    </label>
    <${ProjectChoice} value=${project} onChange=${setProject} />
    <p role="status">${state.text || ""}</p>
    ${state.error && html`<${Failure} error=${state.error} />`}
    ${state.file && html`<p><button type="button" onClick=${() => upload(state.file)}>Send ${state.file.name} again</button></p>`}
  </section>`;
}

function Model({ model, again }) {
  const [error, setError] = useState(null);
  const { description: found } = model;
  const discard = () => remove(model.links.self).then(again, setError);
  return html`<section class="card stack">
    <h2>${modelName(model)}</h2>
    <p class="facts"><span class="status ${model.status === "ready" ? "succeeded" : model.status === "refused" ? "failed" : ""}">${model.status}</span>
      ${` · ${bytes(model.size)} · ${ago(model.created_at)}${whose(model)}`}</p>
    <${Said} file=${model} />
    ${found && html`<${Owned} found=${found} />`}
    <p class="actions">
      ${found?.recipe && html`<a class="button" href=${href(["submit"], { job: JSON.stringify(walkingJob(model)) })}>Let it walk by command</a>`}
      ${model.status === "ready" && html`<a class=${found?.recipe ? "" : "button"} href=${href(["submit"], { environment: "mjcf", model: model.id })}>${found?.recipe ? "Train it on terms of your own" : "Train it"}</a>`}
    </p>
    ${found?.notes.map((note) => html`<p class="facts"><${Prose} text=${note} /></p>`)}
    ${found?.recipe && html`<${Recipe} model=${model} />`}
    ${found && html`<${Engines} found=${found} /><${Parts} found=${found} />`}
    <p class="facts"><code>${model.id}</code>${found?.main && `, read from ${found.main}`}</p>
    ${error && html`<${Failure} error=${error} />`}
    <p class="actions"><${Confirm} text="Delete" question="Delete this model?" onYes=${discard} isDangerous /></p>
  </section>`;
}

/** A job in which the robot learns to walk by command: `gaitway models show NAME --recipe`. */
const walkingJob = ({ id, description: { recipe } }) => ({ kind: "train", environment: { id: "mjcf", options: { model: id, ...recipe } }, battery: true });

function Recipe({ model }) {
  const { recipe_notes: notes = [] } = model.description;
  return html`<details><summary>A job in which it learns to walk by command</summary>
    ${notes.map((note) => html`<p class="facts"><${Prose} text=${note} /></p>`)}
    <${Copy} text=${JSON.stringify(walkingJob(model), null, 2)} name="The job as JSON" />
  </details>`;
}

const ableOf = (engines) => Object.keys(engines).filter((name) => engines[name] === null);

/** What its owner can judge: how it stands in its recipe, what runs that, and how heavy and high it is. */
function Owned({ found: { inventory, recipe, recipe_engines: edited = {}, settled_height: settled } }) {
  const { feet = [], pose = {} } = recipe?.edits || {};
  const able = ableOf(edited);
  return html`<dl class="facts-list">
    ${feet.length > 0 && html`<dt>Feet</dt><dd>${feet.join(", ")}</dd>`}
    ${feet.length > 0 && html`<dt>Pose</dt><dd>${pose.keyframe ? `the keyframe ${pose.keyframe}` : pose.joints ? "joints as the recipe says" : "as it is in its file"}</dd>`}
    ${able.length > 0 && html`<dt>Engines</dt><dd>${able.join(", ")}, with the recipe's edits</dd>`}
    <dt>Root</dt><dd>${inventory.root}, ${inventory.travels ? "travels" : "stays in its place"}; ${value(inventory.initial_height)} m high, settles at ${value(settled)} m without actions</dd>
    <dt>Mass</dt><dd>${value(inventory.mass_kg)} kg</dd>
  </dl>`;
}

/** Which engines run the file without edits, and how each moved it beside C MuJoCo. */
function Engines({ found: { engines, trials = {}, code_seconds: made = {}, auto = {}, complete } }) {
  const names = [...new Set([...Object.keys(engines), ...Object.keys(trials)])];
  const chosen = Object.entries(auto).map(([device, name]) => `${name} on a ${device.toUpperCase()}`);
  const told = (name) => (engines[name] ? `does not run it as it is: ${engines[name]}` : `${trials[name] || "runs it"}${name in made ? ` (its code took ${duration(made[name])} to make)` : ""}`);
  return html`<details><summary>Engines, as it is: ${ableOf(engines).join(", ") || "none yet"}${complete ? "" : " (others are still tried)"}</summary>
    <p class="facts">Beside C MuJoCo, without edits. A job's <code>edits</code> may let more of them run it.</p>
    <dl class="facts-list">
      ${names.map((name) => html`<dt>${name}</dt><dd><${Prose} text=${told(name)} /></dd>`)}
      ${chosen.length > 0 && html`<dt>Chosen</dt><dd>${chosen.join(", ")}</dd>`}
    </dl>
  </details>`;
}

function Parts({ found: { inventory, physics_steps_per_second: speed } }) {
  const { nq, nv, nu } = inventory.sizes;
  return html`<details><summary>Parts: joints ${inventory.joints.length}, actuators ${nu}</summary><dl class="facts-list">
    <dt>Sizes</dt><dd>nq ${nq}, nv ${nv}, nu ${nu}; steps of ${duration(inventory.timestep_s)}</dd>
    <dt>Speed</dt><dd>${compact(speed)} physics steps/s of C MuJoCo on one core</dd>
    ${LISTS.map((kind) => html`<dt>${kind}</dt><dd><${Names} items=${inventory[kind]} /></dd>`)}
  </dl></details>`;
}

/** A part's name, with an actuator's range, and a sensor's kind with the engines that cannot read it. */
function nameOfPart(item) {
  const name = (item.name ?? item) || "(without a name)";
  if (item.control_range) return `${name} [${item.control_range.map(value).join(", ")}]`;
  const beyond = Object.keys(item.beyond ?? {}).join(", ");
  return item.size ? `${name} (${item.type}${beyond ? `, not on ${beyond}` : ""})` : name;
}

function Names({ items }) {
  if (!items.length) return "none";
  const names = items.map(nameOfPart).join(", ");
  return names.length < 60 ? names : html`<details><summary>${items.length}</summary>${names}</details>`;
}
