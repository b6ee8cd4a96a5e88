/** Files that the page makes and the reader keeps. */

/** Offer a blob as a download. */
export function save(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** A field of CSV (RFC 4180). A name that a spreadsheet would run as a formula gets an apostrophe in front. */
const field = (value) => {
  const text = typeof value === "string" && /^[=+\-@\t\r]/.test(value) ? `'${value}` : String(value ?? "");
  return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
};

/** Curves of one metric as a table: a line for each value. curves: pairs of a job and its curve. */
export function toCsv(curves, metric) {
  const rows = curves.flatMap(([job, curve]) =>
    (curve?.steps || []).map((step, i) => [job.id, job.label, step, new Date(curve.times[i]).toISOString(), curve.values[i]]),
  );
  return [["job", "name", "step", "time", metric], ...rows].map((row) => row.map(field).join(",")).join("\r\n") + "\r\n";
}
