// Geometry of what the map shows, in metres, [north, east], NED: heading clockwise from north. Pure.

const CHI2_95 = 5.991; // 95 % of a normal distribution in two dimensions
const ELLIPSE_POINTS = 48;

/** Body axes (forward, starboard) to [north, east]. */
export function toMap({ north_m, east_m, psi_rad }, forward, starboard) {
  const c = Math.cos(psi_rad);
  const s = Math.sin(psi_rad);
  return [north_m + c * forward - s * starboard, east_m + s * forward + c * starboard];
}

/** Length and beam of a boat [m]; where it does not tell, so that its thrusters lie inside. */
export function sizeOf(about) {
  const reach = (key) => 2.4 * Math.max(0.1, ...(about?.thrusters ?? []).map((t) => Math.abs(t[key])));
  return { length: about?.length_m ?? reach("x_m"), beam: about?.beam_m ?? reach("y_m") };
}

/** Outline of the hull, to scale: a deck plan with a bow. */
export function outline(pose, about) {
  const { length, beam } = sizeOf(about);
  const half = beam / 2;
  const bow = length / 2;
  return [
    [bow, 0], [bow * 0.72, half * 0.72], [bow * 0.35, half], [-bow, half * 0.92],
    [-bow, -half * 0.92], [bow * 0.35, -half], [bow * 0.72, -half * 0.72],
  ].map(([x, y]) => toMap(pose, x, y));
}

/**
 * Arrow of one thruster's force on the boat: the line, and its head. Its length is the boat's times the square root of
 * the share of full force, so that the small forces of cruising can be seen. Null: (almost) none.
 */
export function arrow(pose, about, thruster, force_n) {
  const full = Math.max(Math.abs(thruster.force_max_n), Math.abs(thruster.force_min_n), 0.1);
  const share = Math.max(-1, Math.min(1, force_n / full));
  if (Math.abs(share) < 0.002) return null;
  const long = sizeOf(about).length * Math.sign(share) * Math.sqrt(Math.abs(share));
  const angle = (thruster.azimuth_deg * Math.PI) / 180;
  const along = [Math.cos(angle), Math.sin(angle)];
  const tip = [thruster.x_m + long * along[0], thruster.y_m + long * along[1]];
  const head = 0.3 * long;
  const wing = (side) => [
    tip[0] - head * along[0] - side * 0.6 * head * along[1],
    tip[1] - head * along[1] + side * 0.6 * head * along[0],
  ];
  const place = ([x, y]) => toMap(pose, x, y);
  return { line: [[thruster.x_m, thruster.y_m], tip].map(place), head: [tip, wing(1), wing(-1)].map(place) };
}

/** 95 % ellipse of the position. `covariance`: upper triangle of the 6 x 6, row by row. */
export function ellipse({ north_m, east_m, covariance }) {
  const [nn, ne] = covariance;
  const ee = covariance[6];
  const mean = (nn + ee) / 2;
  const apart = Math.hypot((nn - ee) / 2, ne);
  const a = Math.sqrt(CHI2_95 * Math.max(mean + apart, 0));
  const b = Math.sqrt(CHI2_95 * Math.max(mean - apart, 0));
  const turn = 0.5 * Math.atan2(2 * ne, nn - ee);
  return Array.from({ length: ELLIPSE_POINTS }, (_, k) => {
    const angle = (2 * Math.PI * k) / ELLIPSE_POINTS;
    return toMap({ north_m, east_m, psi_rad: turn }, a * Math.cos(angle), b * Math.sin(angle));
  });
}

/** Standard deviation of the position [m], along the worse axis. */
export function sigma(covariance) {
  const [nn, ne] = covariance;
  const ee = covariance[6];
  return Math.sqrt(Math.max((nn + ee) / 2 + Math.hypot((nn - ee) / 2, ne), 0));
}

/** The state, where it says where the boat is: before the first position it stands at zero. */
export function placed(state) {
  return state && state.health !== "initialising" ? state : undefined;
}

/** Heading from true north [rad] of a state in site axes; undefined where there is none. */
export function compass(state, about) {
  return state && state.psi_rad + (about?.rotation_deg ?? 0) / DEGREES;
}

const WGS84_A_M = 6378137.0; // NIMA TR8350.2
const WGS84_E2 = 6.69437999014e-3;
const DEGREES = 180 / Math.PI;

/** [latitude, longitude] in degrees of a place in site axes, earth flat around the origin (companion.core.geometry.frames); null: not known. */
export function geodetic(about, [north_m, east_m]) {
  if (!about || (about.lat_deg === 0 && about.lon_deg === 0)) return null;
  const [north, east] = toMap({ north_m: 0, east_m: 0, psi_rad: about.rotation_deg / DEGREES }, north_m, east_m);
  const [north_m_deg, east_m_deg] = degree(about);
  return [about.lat_deg + north / north_m_deg, about.lon_deg + east / east_m_deg];
}

/** Metres of a degree of latitude and of longitude at a site's origin. */
function degree({ lat_deg }) {
  const latitude = lat_deg / DEGREES;
  const q = 1 - WGS84_E2 * Math.sin(latitude) ** 2;
  const vertical = WGS84_A_M / Math.sqrt(q);
  return [(vertical * (1 - WGS84_E2)) / q / DEGREES, (vertical * Math.cos(latitude)) / DEGREES];
}

const AXES = ["site", "lat_deg", "lon_deg", "rotation_deg"];

/** A state in the axes of site `from`, in those of site `to`; undefined where one of two sites does not say where on earth it lies. */
export function inSite(state, from, to) {
  if (!state || !from || !to || AXES.every((key) => from[key] === to[key])) return state;
  const at = geodetic(from, [state.north_m, state.east_m]);
  if (!at || !geodetic(to, [0, 0])) return undefined;
  const [north_m_deg, east_m_deg] = degree(to);
  const away = [(at[0] - to.lat_deg) * north_m_deg, (at[1] - to.lon_deg) * east_m_deg];
  const [north_m, east_m] = toMap({ north_m: 0, east_m: 0, psi_rad: -to.rotation_deg / DEGREES }, ...away);
  return { ...state, north_m, east_m, psi_rad: state.psi_rad + (from.rotation_deg - to.rotation_deg) / DEGREES };
}

const FRESH_NS = 1.5e9;

/** The sample where it is about as new as the state: guidance and plan are not told while nothing steers. */
export function fresh(sample, state) {
  return sample && state && sample.t_ns > state.t_ns - FRESH_NS ? sample : undefined;
}

/** Guidance's last word, where it is of this path: another one that was loaded since has not been begun. */
export function guided(reference, path) {
  return path?.t_ns > reference?.t_ns ? undefined : reference;
}

const SENSOR_NS = 3e9; // what sensors say comes twice a second at most

/** The same of what a sensor told: it is told when it is new alone, and one that fell silent tells nothing now. */
export function heard(sample, state) {
  return sample && state && sample.t_ns <= state.t_ns - SENSOR_NS ? undefined : sample;
}

/** A round step (1, 2, 5 times a power of ten) that is at least `least`. */
export function roundStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((k) => k * power).find((step) => step >= least * 0.999);
}
