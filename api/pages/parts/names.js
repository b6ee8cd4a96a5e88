/** Lists of names or patterns, and numbers by them: a line for each, and one more to type the next. */

import { html, useState } from "../lib/html.js";

// The kind of parts that a field names.
const KINDS = {
  ...{ root: ["bodies"], body: ["bodies"], target: ["bodies"], bodies: ["bodies"], feet: ["bodies"] },
  ...{ geoms: ["geoms"], against: ["geoms"], names: ["sensors", "bodies", "joints", "geoms"] },
  ...{ joints: ["joints"], without: ["joints"], weights: ["joints"] },
  ...{ standing: ["joints"], walking: ["joints"], running: ["joints"], keyframe: ["keyframes"] },
};

/** The names of a model's parts that a field of this name takes. */
export const partsNamed = (parts, name) => (KINDS[name] || []).flatMap((kind) => parts?.[kind] || []);

const isSame = (one, other) => JSON.stringify(one) === JSON.stringify(other);

/** What is typed, kept while it stands for what is said; otherwise what is said. */
function useTyped(said, meaning) {
  const [typed, setTyped] = useState([]);
  const value = said ?? meaning([]);
  return [isSame(meaning(typed), value) ? typed : Array.isArray(value) ? value : Object.entries(value), setTyped];
}

const withoutEmpty = (names) => names.filter((name) => name !== "");

const isLastEmpty = (lines) => lines.length > 0 && lines.at(-1) === "";

function trimmed(lines) {
  return isLastEmpty(lines) ? trimmed(lines.slice(0, -1)) : lines;
}

export function Names({ common, label, said, planned, schema, isRequired, suggestions, onChange }) {
  const [names, setNames] = useTyped(said, withoutEmpty);
  const change = (next) => {
    setNames(trimmed(next));
    onChange(withoutEmpty(next).length ? withoutEmpty(next) : undefined);
  };
  const placeholder = said === undefined && planned?.length ? planned.join(", ") : isRequired && !names.length ? "required" : "";
  const lines = names.length < (schema.maxItems ?? Infinity) ? [...names, ""] : names;
  return html`<div class="lines">
    ${lines.map((name, i) => html`<${Name} key=${i} ...${i ? { "aria-label": `${label}, ${i + 1}` } : common} value=${name} list="${common.id}-list" placeholder=${i ? "" : placeholder}
      onInput=${({ target }) => change(lines.map((one, at) => (at === i ? target.value : one)))} onBlur=${() => names.includes("") && setNames(withoutEmpty(names))} />`)}
    <${Suggestions} id="${common.id}-list" names=${suggestions} />
    <${Matched} patterns=${withoutEmpty(names)} names=${suggestions} schema=${schema} />
  </div>`;
}

/** The object of pairs; a name without a number is null, which the service refuses. */
const objectOf = (pairs) => Object.fromEntries(pairs.filter(([name]) => name !== "").map(([name, number]) => [name, number ?? null]));

export function ByName({ common, label, said, planned, suggestions, schema, onChange }) {
  const [pairs, setPairs] = useTyped(said, objectOf);
  const change = (next) => {
    setPairs(next);
    onChange(Object.keys(objectOf(next)).length ? objectOf(next) : undefined);
  };
  const [first] = said === undefined ? Object.entries(planned || {}) : [];
  const lines = [...pairs, ["", undefined]];
  const isEmpty = ([name, number]) => name === "" && number === undefined;
  const replace = (i, pair) => change(lines.map((one, at) => (at === i ? pair : one)).filter((one, at) => at < pairs.length || !isEmpty(one)));
  const tidy = () => pairs.some(isEmpty) && setPairs(pairs.filter((one) => !isEmpty(one)));
  return html`<div class="lines" onBlurCapture=${({ currentTarget, relatedTarget }) => currentTarget.contains(relatedTarget) || tidy()}>
    ${lines.map(([name, number], i) => html`<span class="pair" key=${i}>
      <${Name} ...${i ? { "aria-label": `${label}, ${i + 1}` } : common} value=${name} list="${common.id}-list" placeholder=${i ? "" : first?.[0] ?? ""}
        onInput=${({ target }) => replace(i, [target.value, number])} />
      <${Amount} label="${label} of ${name || "the next"}" value=${number} placeholder=${i ? "" : first?.[1] ?? ""} onChange=${(next) => replace(i, [name, next])} />
    </span>`)}
    <${Suggestions} id="${common.id}-list" names=${suggestions} />
    <${Matched} patterns=${Object.keys(objectOf(pairs))} names=${suggestions} schema=${schema} />
  </div>`;
}

const Name = (attributes) => html`<input type="text" autocomplete="off" spellcheck=${false} ...${attributes} />`;

function Amount({ label, value, placeholder, onChange }) {
  const [typed, setTyped] = useState(null);
  const type = ({ target }) => {
    const text = target.value.trim();
    setTyped(target.value);
    onChange(text === "" ? undefined : Number.isFinite(Number(text)) ? Number(text) : text);
  };
  return html`<input type="text" inputmode="decimal" aria-label=${label} value=${typed ?? value ?? ""} placeholder=${placeholder} onInput=${type} onBlur=${() => setTyped(null)} />`;
}

const Suggestions = ({ id, names }) => html`<datalist id=${id}>${(names || []).map((one) => html`<option key=${one} value=${one}></option>`)}</datalist>`;

const MOST = 6;

/** Which of the model's parts the patterns match. */
function Matched({ patterns, names, schema }) {
  if (!patterns.length || !names?.length || !/regular expression/.test(schema.description || "")) return null;
  const found = names.filter((name) => patterns.some((pattern) => matches(pattern, name)));
  const some = `${found.slice(0, MOST).join(", ")}${found.length > MOST ? ", …" : ""}`;
  return html`<p class="facts">${found.length ? `Matches ${found.length} of ${names.length}: ${some}` : `Matches none of ${names.length}.`}</p>`;
}

function matches(pattern, name) {
  try {
    return pattern === name || new RegExp(`^(?:${pattern})$`).test(name);
  } catch {
    return false;
  }
}
