/** The same submission as a document, for curl and for Python. */

import { html, useState } from "../../lib/html.js";
import { Copy } from "../../parts/copy.js";

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
