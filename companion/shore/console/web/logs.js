// Logs of the folder that the console was started with: what there is, to download and to open.

import { make } from "./panels.js";
import { figure } from "./words.js";

const link = (href, text, name) => {
  const a = Object.assign(make("a", "", text), { href });
  a.setAttribute("aria-label", `${text} ${name}`);
  return a;
};

/** The newest first; a sentence where there is none, or the list could not be had. */
export async function showLogs(element) {
  let rows;
  try {
    const answer = await fetch("/logs");
    if (!answer.ok) throw new Error(await answer.text());
    rows = await answer.json();
  } catch (error) {
    return element.replaceChildren(make("p", "none", `The list of logs could not be had: ${error.message}`));
  }
  if (!rows.length) return element.replaceChildren(make("p", "none", "No logs (.mcap) in this folder yet."));
  const table = make("table");
  const head = table.createTHead().insertRow();
  for (const name of ["Log", "Changed", "Size", "What to do"]) head.append(Object.assign(make("th", "", name), { scope: "col" }));
  const body = table.createTBody();
  for (const { name, bytes, unix_s, page } of rows) {
    const row = body.insertRow();
    row.append(Object.assign(make("th", "", name), { scope: "row" }));
    row.insertCell().textContent = new Date(unix_s * 1e3).toLocaleString("en-GB");
    row.insertCell().textContent = figure(bytes / 1e6, 1, "MB");
    const does = row.insertCell();
    const asked = `name=${encodeURIComponent(name)}`;
    does.append(Object.assign(link(`/logs/file?${asked}`, "Download", name), { download: name.split("/").at(-1) }));
    if (page) does.append(Object.assign(link(`/logs/page?${asked}`, "Open", name), { target: "_blank", rel: "noopener" }));
  }
  element.replaceChildren(table);
}
