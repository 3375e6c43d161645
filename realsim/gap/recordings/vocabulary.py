"""Words of columns and topics in the languages that logs are written in, as plain English.

`Ellbogen_soll [deg]` -> elbow, target, deg; `qRef3` -> position, target, 3. What reads names sees English only.
"""

import re
import unicodedata
from functools import lru_cache

from realsim.gap.case.units import TIME as TIMES

_SIGNALS = {
    "time": "time zeit zeitstempel tiempo tempo czas horodatage horodate 时间 時間 時刻",
    "timestamp": "timestamp",
    "target": "cmd cmds command commands commanded des desired desire target targets goal goals ref refs reference"
    " setpoint setpoints set sp action actions ctrl control con demand demanded dmd wanted request requested planned"
    " soll sollwert sollwerte vorgabe befehl consigne consignes cible ordre commande consigna objetivo deseado deseada"
    " referencia comando riferimento desiderato desiderata zadana input inputs 指令 命令 目标 期望 给定 目標 指示",
    "measured": "act actual meas measured measurement fb fbk feedback present real sensed state states readback ist"
    " istwert istwerte gemessen mesure mesures mesuree reel medido medida actuel misurato misurata attuale zmierzona"
    " 实际 反馈 测量 当前 実測 現在 実際",
    "position": "q qpos pos position positions angle angles theta joints dof_pos encoder encoders enc winkel lage"
    " stellung posicion posiciones posizione angulo angolo pozycja 位置 角度",
    "velocity": "dq qd qdot qvel vel vels velocity velocities speed speeds spd dtheta geschwindigkeit drehzahl vitesse"
    " vitesses velocidad velocidades velocita 速度 转速",
    "torque": "tau taus torque torques effort efforts trq tq load drehmoment moment couple couples coppia esfuerzo 力矩"
    " 扭矩 トルク",
    "electric": "electric amps iq strom courant corriente corrente 电流 電流",
    "current": "current currents",
    "observation": "observation obs data value values measured_value sensor",
    "filtered": "filt filtered filter smooth smoothed lowpass est estimate estimated gefiltert filtre",
}
_PARTS = {
    "joint": "joint motor servo dof gelenk achse articulation articulacion giunto axe axis eje asse 关节 関節 軸 轴",
    "shoulder": "shoulder schulter epaule hombro ombro spalla 肩",
    "elbow": "elbow ellbogen ellenbogen coude codo cotovelo gomito 肘",
    "wrist": "wrist handgelenk poignet muneca polso 腕", "hip": "hip haa huefte hufte hanche cadera quadril anca 髋",
    "knee": "knee knie genou rodilla joelho ginocchio 膝",
    "ankle": "ankle knoechel knochel cheville tobillo tornozelo caviglia sprunggelenk fussgelenk 踝",
    "thigh": "thigh hfe oberschenkel cuisse muslo coscia 大腿",
    "calf": "calf kfe shank unterschenkel mollet pantorrilla 小腿",
    "fl": "lf", "fr": "rf", "rl": "lh", "rr": "rh", "pan": "pan schwenk", "tilt": "tilt neigung inclinaison",
    "leg": "leg bein jambe pierna gamba", "left": "left links gauche izquierda izquierdo sinistra sinistro 左",
    "right": "right rechts droite droit derecha derecho destra destro 右", "waist": "waist taille cintura",
    "gripper": "gripper greifer pince pinza 夹爪", "error": "error err errors fehler abweichung erreur 误差 偏差",
    "temperature": "temp temps temperature temperatures temperatur 温度",
    "voltage": "volt volts voltage voltages spannung tension 电压 電圧",
}  # fmt: skip
SIDES = ("target", "measured")
KINDS = ("position", "velocity", "torque", "electric")
SIGNALS = (*SIDES, *KINDS, "time", "timestamp", "observation", "filtered", "raw")
"""Words that say what a column holds; what is left of its name says where."""
_ENGLISH = {word: meant for meant, words in (_SIGNALS | _PARTS).items() for word in words.split()}
_SHORT = ("q",)
"""Single letters that may begin a compound: qdes."""
_FOREIGN_SCRIPT = re.compile("|".join(sorted((w for w in _ENGLISH if not w.isascii()), key=len, reverse=True)))
_UNITS = {
    "deg": "deg degree degrees ° grad degre degres grados graus gradi", "rad": "rad radian radians",
    "rev": "rev revs turn turns", "deg/s": "deg/s dps °/s degs grad/s deg_s deg_per_s deg/sec degrees/s",
    "rad/s": "rad/s rads rad_s rad_per_s rad/sec radians/s", "rpm": "rpm rev/min r/min u/min 1/min tr/min upm min-1",
    "rev/s": "rev/s rps", "N m": "nm n_m n*m n.m n·m newtonmeter", "mN m": "mnm mn*m", "N cm": "ncm",
    "kgf cm": "kgfcm kgf*cm kg*cm kgcm", "A": "a amp ampere amps", "mA": "ma",
    "s": "s sec secs second seconds sekunden secondes segundos",
    "ms": "ms msec msecs milli millis millisecond milliseconds",
    "us": "us µs μs usec usecs micro micros microsecond microseconds",
    "ns": "ns nsec nsecs nano nanos nanosec nanosecond nanoseconds",
    "min": "min minute minutes minuten", "h": "h hour hours stunden heures",
} | {unit: unit for unit in ("mrad", "mdeg", "mdeg/s", "mm", "m", "mm/s", "m/s", "g", "%")}  # fmt: skip
_UNIT_OF = {text: unit for unit, texts in _UNITS.items() for text in texts.split()}
_BARE = {t: u for t, u in _UNIT_OF.items() if len(t) > 1 and t != "min"}
"""Units that need no bracket: `speed_rpm`; a single letter at the end of a name is a name, `q_min` the least."""
_CLOCKS = {"time", "timestamp", "t", "stamp", "tick", "ticks", "clock", "rectime", "elapsed", "uptime", "epoch"}
_CLOCKS |= {"times", "timestamps"} | {text for text, unit in _BARE.items() if unit in TIMES and len(text) > 2}
_BESIDE_CLOCKS = {
    word
    for words in (
        "boot sample ros rosbag log header sim simulation unix system sys host utc local receive recv",
        "received since start loop record s ms us ns",
    )
    for word in words.split()
}
"""Words beside them in names of clocks."""
_BRACKET = re.compile(r"[\[(]\s*([^\[\]()]*?)\s*[\])]\s*$|(?:\s/\s|\sin\s)\s*(\S+)\s*$|\.\.(\w+(?:\.\w+)?)\.$")
"""The last as R writes it: `angle (deg/s)` -> `angle..deg.s.`."""


def plain(name: str) -> str:
    """A name in lower case without accents, one kind of separator: `Goal Position (deg)` -> `goal_position_deg`."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name.replace("ß", "ss"))
    bare = unicodedata.normalize("NFKD", spaced).encode("ascii", "ignore").decode().lower()
    return re.sub(r"[^a-z0-9]+", "_", bare).strip("_")


def split_unit(name: str) -> tuple[str, str]:
    """(the name without its unit, the unit or nothing): `q1 [deg]`, `Lage / °`, `speed_rpm`."""
    found = _BRACKET.search(name)
    text = (found[1] or found[2] or (found[3] or "").replace(".", "/")).lower().replace(" ", "") if found else ""
    if found and text in _UNIT_OF:
        return name[: found.start()].strip(), _UNIT_OF[text]
    parts = re.split(r"[_\s.\-]+", name.strip())
    for count in (3, 2, 1):
        last = "_".join(parts[-count:]).lower()
        if len(parts) > count and last in _BARE:
            return re.sub(r"[_\s.\-]+$", "", name.strip()[: -len(last)]), _BARE[last]
    camel = re.search(r"(?<=[a-z])(Deg|Rad|Rpm|Nm|Ms|Us|Ns)$", name)
    return (name[: camel.start()], _BARE[camel[0].lower()]) if camel else (name, "")


def unit_of(name: str) -> str:
    """The unit that a name gives, or nothing."""
    return split_unit(name)[1]


def time_unit(name: str) -> str:
    """The unit of time that a name gives, or nothing: `uptime_ms`, `micros`, `time_s`."""
    unit = unit_of(name) or _UNIT_OF.get(plain(name).rpartition("_")[2], "")
    return unit if unit in TIMES else ""


def is_clock(name: str) -> bool:
    """Whether a column or member is a time or a counter, by its name."""
    found = [w for w in english(name) if not w.isdigit()]
    return bool(set(found) & _CLOCKS) and set(found) <= _CLOCKS | _BESIDE_CLOCKS


@lru_cache(maxsize=20_000)
def english(name: str) -> tuple[str, ...]:
    """The words of a name in English, numbers apart and its unit left out: `FL_Ist2 [rad]` -> fl, measured, 2."""
    text = _FOREIGN_SCRIPT.sub(lambda m: f" {_ENGLISH[m[0]]} ", split_unit(name)[0])
    text = re.sub(r"(?<![a-z])d_axis", "flux", re.sub(r"(?<![a-z])q_axis", "electric", plain(text)))  # of a motor
    found = [w for token in re.findall(r"[a-z]+|[0-9]+", text) for w in _meant(token)]
    kind = any(w in KINDS for w in found)
    # `current_position` is the present one; `motor_current` is in amperes.
    return tuple({"current": "measured" if kind else "electric"}.get(w, w) for w in found)


def _meant(token: str) -> list[str]:
    """A word in English; a compound of two known words as both: sollwinkel, qref."""
    if token in _ENGLISH:
        return [_ENGLISH[token]]
    for k in range(len(token) - 2, 0, -1):
        head, tail = token[:k], token[k:]
        if head in _ENGLISH and tail in _ENGLISH and (k > 1 or head in _SHORT):
            return [_ENGLISH[head], _ENGLISH[tail]]
    return [token]
