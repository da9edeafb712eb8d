// Read stems from the bus: node read_stems.mjs ENDPOINT [RIG] [COUNT]
// One JSON object a line: tick, outcome, tip. Nanoseconds do not fit a JavaScript number (2^53), hence useBigInt64.

import { decode } from "@msgpack/msgpack";
import { Subscriber } from "zeromq";

const [endpoint, rig = "box1", count = "0"] = process.argv.slice(2);
if (!endpoint) {
  console.error("usage: node read_stems.mjs ENDPOINT [RIG] [COUNT]");
  process.exit(2);
}

const socket = new Subscriber();
socket.connect(endpoint);
socket.subscribe(`${rig}/stem`);

let shown = 0;
let last = { session: "", seq: 0n };
for await (const [topic, payload] of socket) {
  const stem = decode(payload, { useBigInt64: true });
  const seq = BigInt(stem.seq);
  if (stem.session === last.session && seq <= last.seq) continue; // the bus repeats the last value to late comers
  last = { session: stem.session, seq };
  const tip = stem.points_cm.at(-1) ?? null;
  const shownStem = { topic: topic.toString(), tick: Number(stem.tick), outcome: stem.outcome, tip };
  console.log(JSON.stringify({ ...shownStem, t_utc_ns: String(stem.t_utc_ns) }));
  shown += 1;
  if (shown === Number(count)) break;
}
socket.close();
