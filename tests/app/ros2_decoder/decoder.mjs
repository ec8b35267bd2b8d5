// Holds tagdock's ROS 2 messages to an independent implementation, both ways.
//   node decoder.mjs PEER DOMAIN [exact command before PEER ...]
// PEER payloads prints every message as bytes from the wire and as the fields that were written: they must decode to
// just those fields, and end where the message ends. Then other values are encoded here, and PEER decode must read them.
import { parse } from "@foxglove/rosmsg";
import { ros2humble } from "@foxglove/rosmsg-msgs-common";
import { MessageReader, MessageWriter } from "@foxglove/rosmsg2-serialization";
import { spawnSync } from "node:child_process";

const [peer, domain] = process.argv.slice(2);

// From the apriltag_msgs package, which the collection of common messages does not have.
const apriltag = `std_msgs/Header header
AprilTagDetection[] detections
================================================================================
MSG: apriltag_msgs/AprilTagDetection
string family
int32 id
int32 hamming
float32 goodness
float32 decision_margin
apriltag_msgs/Point centre
apriltag_msgs/Point[4] corners
float64[9] homography
================================================================================
MSG: apriltag_msgs/Point
float64 x
float64 y
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
`;

// All definitions that a type needs, itself first and without a name, as the reader wants them.
function definitions(type) {
  if (type === "apriltag_msgs/msg/AprilTagDetectionArray") return parse(apriltag, { ros2: true });
  const found = [];
  const add = (name) => {
    if (found.some((one) => one.name === name)) return;
    const definition = ros2humble[name] ?? ros2humble[name.replace("/msg/", "/")];
    if (!definition) throw new Error(`no definition of ${name}`);
    found.push({ ...definition, name });
    for (const field of definition.definitions) if (field.isComplex) add(field.type);
  };
  const [first] = [type.replace("/msg/", "/")].filter((name) => ros2humble[name]).concat(type);
  add(first);
  return [{ ...found[0], name: undefined }, ...found.slice(1)];
}

const plain = (value) =>
  JSON.parse(
    JSON.stringify(value, (_, one) => (ArrayBuffer.isView(one) ? Array.from(one) : typeof one === "bigint" ? Number(one) : one)),
  );

function same(a, b, path = "") {
  if (typeof a === "number" && typeof b === "number") return Object.is(a, b) || a === b ? [] : [`${path}: ${a} != ${b}`];
  if (a === null || b === null || typeof a !== "object" || typeof b !== "object")
    return a === b ? [] : [`${path}: ${JSON.stringify(a)} != ${JSON.stringify(b)}`];
  const keys = new Set([...Object.keys(a), ...Object.keys(b)]);
  return [...keys].flatMap((key) => same(a[key], b[key], `${path}.${key}`));
}

function leaves(value) {
  return value !== null && typeof value === "object" ? Object.values(value).reduce((sum, one) => sum + leaves(one), 0) : 1;
}

function run(mode, input) {
  const ran = spawnSync(peer, [mode, domain], { input, encoding: "utf8", timeout: 60000 });
  if (ran.status !== 0) throw new Error(`${mode}: ${ran.status} ${ran.stdout} ${ran.stderr}`);
  return ran.stdout.trim().split("\n");
}

let failures = 0;
let compared = 0;
const check = (what, differences) => {
  failures += differences.length;
  for (const one of differences) console.log(`${what}${one}`);
};

// Other values of the same shape: every number and string changed, and sequences one longer.
let next = 1000;
function other(value, key) {
  if (typeof value === "number") {
    next += 1;
    if (key === "sec" || key === "nanosec" || key === "id" || key === "hamming") return next;
    return key === "level" ? 2 : next + 0.25;
  }
  if (typeof value === "string") return `${value}+${(next += 1)}`;
  if (typeof value === "boolean") return !value;
  if (Array.isArray(value)) {
    const all = value.map((one) => other(one, key));
    if (["poses", "status", "detections", "values"].includes(key) && value.length > 0) all.push(other(value[0], key));
    return all;
  }
  return Object.fromEntries(Object.entries(value).map(([name, one]) => [name, other(one, name)]));
}

const questions = [];
for (const line of run("payloads")) {
  const { type, cdr, fields } = JSON.parse(line);
  const bytes = Buffer.from(cdr, "hex");
  const reader = new MessageReader(definitions(type));
  const decoded = plain(reader.readMessage(bytes));
  check(`${type} from tagdock: `, same(fields, decoded));
  compared += leaves(fields);
  // Encoded here, the same fields must give the same bytes: nothing before, between or behind.
  const writer = new MessageWriter(definitions(type));
  const again = Buffer.from(writer.writeMessage(fields));
  // Cyclone pads the payload to a multiple of four and says by how much in the last byte of the encapsulation.
  const padding = bytes[3] & 3;
  if (!again.subarray(4).equals(bytes.subarray(4, bytes.length - padding)))
    check(`${type}: `, [`${bytes.length} bytes from tagdock are not the ${again.length} of the independent encoder`]);
  const changed = other(fields, "");
  questions.push({ type, changed, hex: Buffer.from(new MessageWriter(definitions(type)).writeMessage(changed)).toString("hex") });
}
const answers = run("decode", questions.map(({ type, hex }) => `${type} ${hex}`).join("\n") + "\n");
questions.forEach(({ type, changed }, i) => {
  check(`${type} to tagdock: `, same(changed, JSON.parse(answers[i])));
  compared += leaves(changed);
});
console.log(`${questions.length} messages both ways, ${compared} fields compared, ${failures} differ`);
process.exit(failures === 0 && questions.length > 0 ? 0 : 1);
