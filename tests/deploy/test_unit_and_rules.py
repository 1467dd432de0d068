"""The unit and the udev rules: what systemd itself says of the unit, and which device gets which name."""

import re
import shutil
import subprocess
from configparser import RawConfigParser

import pytest

from companion.__main__ import INTERRUPTED, parser
from companion.boat.load_run import EXAMPLES, load_setup

UNIT, RULES = EXAMPLES / "aritra.service", EXAMPLES / "udev" / "70-aritra.rules"
PROGRAM = "/opt/aritra/bin/aritra"
HIGHEST_EXPOSURE = 2.0


def unit():
    """Section -> key -> values, in order."""
    found, section = {}, {}
    for line in UNIT.read_text().splitlines():
        if line.startswith("["):
            section = found.setdefault(line, {})
        elif line and not line.startswith("#"):
            key, _, value = line.partition("=")
            section.setdefault(key, []).append(value)
    return found


@pytest.fixture
def analyze():
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("systemd-analyze is not on this machine")

    def run(*words):
        return subprocess.run([program, *words], capture_output=True, text=True, timeout=60, check=False)

    return run


def test_systemd_finds_nothing_wrong_with_the_unit(analyze, tmp_path):
    program = tmp_path / "aritra"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    installed = tmp_path / "aritra.service"
    installed.write_text(UNIT.read_text().replace(PROGRAM, str(program)))
    done = analyze("verify", "--man=no", str(installed))
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_the_unit_is_hardened(analyze):
    done = analyze("security", "--offline=true", "--no-pager", str(UNIT))
    if "unrecognized option" in done.stderr:
        pytest.skip("systemd-analyze is too old to judge a unit that is not installed")
    found = re.search(r"Overall exposure level for aritra\.service: ([\d.]+)", done.stdout)
    assert found, done.stdout + done.stderr
    assert float(found[1]) <= HIGHEST_EXPOSURE


def test_the_service_starts_idle_and_comes_back_idle():
    service = unit()["[Service]"]
    (command,) = service["ExecStart"]
    words = command.split()
    installed = "/etc/aritra/aritra.toml"
    args = parser().parse_args([str(EXAMPLES / "on-board.toml") if word == installed else word for word in words[1:]])
    assert words[0] == PROGRAM and args.command == "run" and words.count(installed) == 1
    assert args.config == EXAMPLES / "on-board.toml"
    assert not args.start and args.excite is None, "a restart must not arm and drive by itself"
    assert not {"ExecStartPre", "ExecStartPost", "ExecStopPost", "ExecReload"} & set(service)
    assert service["Restart"] == ["on-failure"] and service["RestartPreventExitStatus"] == ["2"]
    assert service["SuccessExitStatus"] == [str(INTERRUPTED)]
    assert service["Type"] == ["notify"] and service["NotifyAccess"] == ["main"]
    assert unit()["[Unit]"]["StartLimitIntervalSec"] == ["0"]


def test_there_is_time_to_let_go_and_to_be_alive():
    """Letting go takes 1.1 s and then the log is closed; a lease comes every 0.1 s."""
    service = unit()["[Service]"]
    assert float(service["TimeoutStopSec"][0]) >= 10 and float(service["WatchdogSec"][0]) >= 5


def test_files_that_must_agree_agree():
    setup = load_setup(EXAMPLES / "on-board.toml")
    service, rules = unit()["[Service]"], RULES.read_text()
    assert setup.run.log.folder == f"/var/lib/{service['StateDirectory'][0]}/logs" and setup.run.log.quota_MB
    for url in (setup.run.mavlink.url, setup.run.uwb.url):
        (name,) = re.fullmatch(r"serial:/dev/([\w-]+):115200", url).groups()
        assert f'SYMLINK+="{name}"' in rules
    (group,) = service["SupplementaryGroups"]
    assert set(re.findall(r'GROUP="(\w+)"', rules)) == {group}
    allowed = {value.removeprefix("char-").removesuffix(" rw") for value in service["DeviceAllow"]}
    assert allowed == {"166", "188", "ttyTHS"}, "USB by major: a name is unknown until a device of its kind was there"


def test_the_unit_is_read_as_it_is_written():
    """The reader above and the standard library's agree on keys that stand once."""
    reader = RawConfigParser(strict=False)
    reader.optionxform = str
    reader.read(UNIT)
    for section, keys in unit().items():
        assert {key: values[-1] for key, values in keys.items()} == dict(reader[section.strip("[]")])


# --- udev ------------------------------------------------------------------------------------------

PAIR = re.compile(r'(\w+)(?:\{(\w+)\})?(==|!=|\+=|=)"([^"]*)"')


def apply(device):
    """What the rules give a device: a reader of the part of udev's language that they use."""
    given, wanted = {"SYMLINK": []}, None
    for line in RULES.read_text().splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        pairs = PAIR.findall(line)
        assert ", ".join(f'{k}{f"{{{a}}}" if a else ""}{o}"{v}"' for k, a, o, v in pairs) == line, "not understood"
        label = next((v for k, _, _, v in pairs if k == "LABEL"), None)
        if wanted is not None and label != wanted:
            continue
        wanted = None
        matches = [(device.get(f"{k}.{a}" if a else k, ""), o, v) for k, a, o, v in pairs if o in ("==", "!=")]
        if not all((have in value.split("|")) == (o == "==") for have, o, value in matches):
            continue
        for k, a, o, v in pairs:
            if k == "GOTO":
                wanted = v
            elif o == "+=":
                given[k].append(v)
            elif o == "=" and k != "LABEL":
                given[f"{k}.{a}" if a else k] = v
    assert wanted is None, f"label {wanted} is not there"
    return given


def tty(vendor, model, interface="00", action="add"):
    env = {"ENV.ID_VENDOR_ID": vendor, "ENV.ID_MODEL_ID": model, "ENV.ID_USB_INTERFACE_NUM": interface}
    return {"ACTION": action, "SUBSYSTEM": "tty", **env}


OPEN = {"GROUP": "dialout", "MODE": "0660", "ENV.ID_MM_PORT_IGNORE": "1"}


@pytest.mark.parametrize(
    ("device", "given"),
    [
        (tty("2dae", "1016"), {"SYMLINK": ["aritra-autopilot"], **OPEN}),
        (tty("2dae", "1058"), {"SYMLINK": ["aritra-autopilot"], **OPEN}),
        (tty("2dae", "1058", "02"), {"SYMLINK": [], **OPEN}),
        (tty("2dae", "1058", action="change"), {"SYMLINK": ["aritra-autopilot"], **OPEN}),
        (tty("2dae", "1058", action="remove"), {"SYMLINK": []}),
        (tty("10c4", "ea60"), {"SYMLINK": ["aritra-uwb"], **OPEN}),
        (tty("1366", "0105"), {"SYMLINK": ["aritra-uwb"], **OPEN}),
        (tty("1a86", "7523"), {"SYMLINK": ["aritra-uwb"], **OPEN}),
        (tty("303a", "1001"), {"SYMLINK": ["aritra-uwb"], **OPEN}),
        (tty("0403", "6001"), {"SYMLINK": []}),
        (tty("1016", "2dae"), {"SYMLINK": []}),
        ({"ACTION": "add", "SUBSYSTEM": "tty"}, {"SYMLINK": []}),
    ],
    ids=lambda x: "-".join(x.values()) if "ACTION" in x else "",
)
def test_devices_get_their_names(device, given):
    assert apply(device) == given


@pytest.mark.parametrize("ids", ["2dae:1016", "2dae:1058", "10c4:ea60", "1366:0105", "1a86:7523", "303a:1001"])
def test_modem_manager_leaves_them_alone(ids):
    vendor, product = ids.split(":")
    usb = {"SUBSYSTEM": "usb", "ENV.DEVTYPE": "usb_device", "ATTR.idVendor": vendor, "ATTR.idProduct": product}
    assert apply({"ACTION": "add", **usb}) == {"SYMLINK": [], "ENV.ID_MM_DEVICE_IGNORE": "1"}
    assert apply({"ACTION": "add", **usb, "ATTR.idProduct": "ffff"}).get("ENV.ID_MM_DEVICE_IGNORE") == (
        "1" if vendor == "2dae" else None
    )


def test_udev_itself_accepts_the_rules():
    udevadm = shutil.which("udevadm")
    if udevadm is None:
        pytest.skip("udevadm is not on this machine")
    done = subprocess.run([udevadm, "verify", str(RULES)], capture_output=True, text=True, timeout=60, check=False)
    if "Unknown command" in done.stderr:
        pytest.skip("udevadm is too old to verify rules (systemd 254 can)")
    assert done.returncode == 0, done.stdout + done.stderr
