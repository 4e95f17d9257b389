// What the page asks its server: every request goes through here, so that a problem becomes one sentence (RFC 9457).

const TOKEN = "preimage-token";
const AGAIN_MS = 700; // until a stream of events that broke off is asked for again

const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given) {
  sessionStorage.setItem(TOKEN, given);
  history.replaceState(null, "", location.pathname + "#/plan");
}

export class Problem extends Error {
  constructor(sentence, status) {
    super(sentence);
    this.status = status;
  }
}

function headers(more) {
  const token = sessionStorage.getItem(TOKEN);
  return token ? { ...more, Authorization: `Bearer ${token}` } : more;
}

async function asked(path, options = {}) {
  let response;
  try {
    response = await fetch(`/api/${path}`, { ...options, headers: headers(options.headers ?? {}) });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem("the studio does not answer: is `preimage studio` still running?", 0);
  }
  if (response.ok) return response;
  const told = await response.json().catch(() => ({}));
  throw new Problem(told.detail ?? `the studio answered ${response.status}`, response.status);
}

export const get = async (path, options) => (await asked(path, options)).json();

export const post = async (path, body, options = {}) =>
  (await asked(path, { method: "POST", body: JSON.stringify(body ?? {}), headers: { "Content-Type": "application/json" }, ...options })).json();

export const upload = async (path, file) =>
  (
    await asked(path, {
      method: "POST",
      body: file,
      headers: { "Content-Type": "application/octet-stream", "X-Name": encodeURIComponent(file.name || "pasted picture") },
    })
  ).json();

export const blob = async (path) => (await asked(path)).blob();

/** Hand a file of the server to the person. */
export async function download(path, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await blob(path));
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}

/** Listen to a job from its beginning to its end; what breaks off goes on after the last event. */
export async function listen(job, tell, signal) {
  let last = -1;
  for (;;) {
    try {
      const response = await asked(`jobs/${job}/events`, { signal, headers: { "Last-Event-ID": last } });
      for await (const event of eventsOf(response.body)) {
        last = event.id;
        tell(event);
        if (["done", "stopped", "failed"].includes(event.event)) return;
      }
    } catch (error) {
      if (signal.aborted || error instanceof Problem) {
        if (!signal.aborted) throw error;
        return;
      }
    }
    await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
  }
}

async function* eventsOf(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    const parts = (text + value).split("\n\n");
    text = parts.pop();
    for (const part of parts) {
      const data = part.split("\n").find((line) => line.startsWith("data: "));
      if (data) yield JSON.parse(data.slice(6));
    }
  }
}
