/** The output of the training process, followed until the job ends. */

import { send } from "../../lib/api.js";
import { html, useEffect, useLayoutEffect, useRef, useState } from "../../lib/html.js";
import { isOver } from "../../lib/job.js";
import { useVisible } from "../../lib/live.js";

const MOST_LINES = 5000;
const PAUSE_MS = 2000;

/** Hand on the text so far again and again until the stream ends; begins anew after a loss of the connection. */
async function read(path, signal, show) {
  for (;;) {
    try {
      const reader = (await send(path, { signal })).body.pipeThrough(new TextDecoderStream()).getReader();
      let text = "";
      show(text);
      for (;;) {
        const { value, done } = await reader.read();
        if (done) return;
        text = (text + value).split("\n").slice(-MOST_LINES - 1).join("\n");
        show(text);
      }
    } catch (error) {
      if (signal.aborted || error.status === 404) return;
      await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
    }
  }
}

export function LogTab({ job }) {
  const [text, setText] = useState(null);
  const box = useRef();
  const isAtEnd = useRef(true);
  const isVisible = useVisible(); // Out of sight, the connection is left to other pages.
  useEffect(() => {
    if (!isVisible) return undefined;
    const control = new AbortController();
    let frame = 0;
    const show = (found) => {
      cancelAnimationFrame(frame);
      frame = requestAnimationFrame(() => setText(found));
    };
    read(`${job.links.logs}?follow=true`, control.signal, show);
    return () => {
      control.abort();
      cancelAnimationFrame(frame);
    };
  }, [job.id, isVisible]);
  useLayoutEffect(() => {
    if (isAtEnd.current && box.current) box.current.scrollTop = box.current.scrollHeight;
  }, [text]);
  const watch = ({ target }) => (isAtEnd.current = target.scrollHeight - target.scrollTop - target.clientHeight < 40);
  return html`
    <p class="facts"><a href=${job.links.logs} download="${job.id}.log">The whole log</a>${isOver(job) ? "" : " · it follows as long as you are at its end"}</p>
    <pre class="log" ref=${box} onScroll=${watch} tabindex="0" role="log" aria-label="Log">${text || (isOver(job) ? "The job printed nothing." : "Nothing printed yet.")}</pre>
  `;
}
