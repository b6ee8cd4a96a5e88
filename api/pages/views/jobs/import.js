/** A job that was exported here or elsewhere, brought in. */

import { send, withQuery } from "../../lib/api.js";
import { bytes } from "../../lib/format.js";
import { html, useEffect, useRef, useState } from "../../lib/html.js";
import { go } from "../../lib/route.js";
import { Failure } from "../../parts/elements.js";
import { ProjectChoice } from "../../parts/whose.js";

export function Import() {
  const [state, setState] = useState({});
  const [project, setProject] = useState();
  // It takes minutes, and whoever has gone on to another view stays there.
  const isHere = useRef(true);
  useEffect(() => () => (isHere.current = false), []);
  const bring = async ({ target: input }) => {
    const [file] = input.files;
    if (!file) return;
    setState({ text: `Sending ${file.name} (${bytes(file.size)})…` });
    try {
      const job = await (await send(withQuery("/jobs/import", { project }), { method: "POST", body: file, type: "application/zip" })).json();
      if (isHere.current) go(["jobs", job.id]);
    } catch (error) {
      setState({ error });
    }
    input.value = "";
  };
  return html`<details class="import">
    <summary>Import an export</summary>
    <label class="field">The zip that “Export” of a job gives, here or on another service:
      <input type="file" accept=".zip" onChange=${bring} />
    </label>
    <${ProjectChoice} value=${project} onChange=${setProject} />
    <p role="status">${state.text || ""}</p>
    ${state.error && html`<${Failure} error=${state.error} />`}
  </details>`;
}
