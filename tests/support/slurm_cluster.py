"""A SLURM of its own for tests: munged, slurmctld and a slurmd for each of two nodes, all on this
machine, in a temporary folder, with a key, a socket and ports of their own.
"""

import contextlib
import os
import re
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

from tests.support.launch import OPEN_MPI, PATIENCE, ROOT

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "scontrol", "sinfo", "srun", "setpriv")
NODES = ("n1", "n2")
START = PATIENCE / 4  # seconds in which all daemons are there
ENDED = ("COMPLETED", "FAILED", "TIMEOUT", "CANCELLED", "NODE_FAIL", "OUT_OF_MEMORY")

# A job that queues itself again begins only when its old credential has expired (two minutes unless
# told). Each node says that it has four cores, so that no job of a test waits for another. Some
# sites end a step with its first task that fails, as here.
CONF = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket,cred_expire=5
CredType=cred/munge
SlurmctldPort={ports[0]}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
TmpFS={folder}/tmp-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SwitchType=switch/none
SlurmdParameters=config_overrides
ReturnToService=2
KillWait=60
KillOnBadExit=1
SchedulerParameters=batch_sched_delay=0,sched_interval=2,requeue_delay=0
NodeName=n1 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[1]} CPUs=4 RealMemory=1000
NodeName=n2 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[2]} CPUs=4 RealMemory=1000
PartitionName=all Nodes=n1,n2 Default=YES MaxTime=INFINITE State=UP
"""


def missing() -> str:
    """Why there can be no cluster here, or ""."""
    path = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"
    absent = [name for name in PROGRAMS if shutil.which(name, path=path) is None]
    if absent:
        return f"no {', '.join(absent)} (apt install slurm-wlm munge)"
    return "" if os.geteuid() == 0 else "SLURM's daemons want root"


class Unable(RuntimeError):
    """SLURM's daemons do not find each other on this machine."""


class Cluster:
    """Jobs go in by `submit`; `close` ends all that it started, and every task of every job."""

    def __init__(self):
        self.folder = Path(tempfile.mkdtemp(prefix="slurm-"))  # short: it holds a socket
        self.env = {
            **os.environ,
            **OPEN_MPI,
            "PATH": os.environ.get("PATH", "") + ":/usr/sbin:/sbin",
            "PYTHONPATH": str(ROOT),
            "SLURM_CONF": str(self.folder / "slurm.conf"),
            # both nodes are this machine, which may have no other interface
            "OMPI_MCA_btl_tcp_if_include": "lo",
        }
        self.daemons: list[subprocess.Popen] = []
        try:
            self._begin()
        except AssertionError as error:
            self.close()
            raise Unable(str(error)) from None
        except BaseException:
            self.close()
            raise

    def _begin(self):
        self.folder.chmod(0o755)
        for name in ("state", *(f"tmp-{node}" for node in NODES)):
            (self.folder / name).mkdir()
        key = self.folder / "munge.key"
        key.touch(0o600)
        key.write_bytes(secrets.token_bytes(64))
        host = socket.gethostname().split(".")[0]
        conf = CONF.format(host=host, folder=self.folder, ports=_free_ports(3))
        (self.folder / "slurm.conf").write_text(conf)
        files = [
            f"--{word}-file={self.folder}/munge.{word}" for word in ("key", "pid", "log", "seed")
        ]
        link = self.folder / "munge.socket"
        self._daemon("munged", "--foreground", "--force", *files, f"--socket={link}")
        self.until(link.exists, "munged's socket", START)
        self._daemon("slurmctld", "-D", "-f", self.env["SLURM_CONF"])
        for node in NODES:
            self._daemon("slurmd", "-D", "-N", node, "-f", self.env["SLURM_CONF"])
        self.until(
            lambda: self.say("sinfo", "-h", "-o", "%D %T") == f"{len(NODES)} idle\n", "nodes", START
        )

    def _daemon(self, *command):
        """Ends with the tests even if those are killed."""
        log = open(self.folder / f"{len(self.daemons)}-{command[0]}.log", "w")
        with log:
            process = subprocess.Popen(
                ["setpriv", "--pdeathsig", "KILL", *command],
                env=self.env, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                start_new_session=True,
            )  # fmt: skip
        self.daemons.append(process)

    def say(self, *command) -> str:
        """What a command of SLURM prints."""
        done = subprocess.run(
            [str(word) for word in command],
            env=self.env,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        return done.stdout

    def submit(self, *words, cwd, **environment) -> str:
        """`sbatch WORDS` in the folder cwd; returns the job's number. Its output: cwd/JOB.out."""
        done = subprocess.run(
            ["sbatch", "--parsable", f"--output={cwd}/%x-%j.out", *(str(word) for word in words)],
            env={**self.env, **environment},
            cwd=cwd,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    def job(self, number) -> dict[str, str]:
        """What SLURM knows of a job or of a task of an array ("40_3")."""
        said = self.say("scontrol", "show", "job", "-o", number)
        return dict(re.findall(r"(\S+?)=(\S*)", said))

    def until_ended(self, number, or_restarted=False) -> dict[str, str]:
        """Wait for the end of a job, or until it was queued again; returns what SLURM then knows of
        it.
        """

        def ended() -> bool:
            now = self.job(number)
            return now.get("JobState") in ENDED or (or_restarted and now.get("Restarts") != "0")

        self.until(ended, f"end of job {number}")
        return self.job(number)

    def tasks(self, number="") -> dict[int, int]:
        """Process of each rank of a job; of all that SLURM started here where none is named."""
        found = {}
        for entry in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                words = (entry / "environ").read_bytes().decode(errors="replace").split("\0")
                has = dict(word.split("=", 1) for word in words if "=" in word)
                daemon = int(entry.name) in [process.pid for process in self.daemons]
                if has.get("SLURM_CONF") != self.env["SLURM_CONF"] or daemon:
                    continue
                if not number:
                    found[int(entry.name)] = int(entry.name)
                elif (
                    has.get("SLURM_JOB_ID") == number
                    and "SLURM_PROCID" in has
                    and "PMIX_RANK" in has
                ):
                    found[int(has["SLURM_PROCID"])] = int(entry.name)
        return found

    def until(self, true, what: str, seconds: float = PATIENCE) -> None:
        """Wait; what never comes fails the test and says what the daemons said."""
        end = time.monotonic() + seconds
        while not true():
            gone = [process.args for process in self.daemons if process.poll() is not None]
            assert not gone and time.monotonic() < end, f"no {what}; ended: {gone}\n{self._logs()}"
            time.sleep(0.1)

    def _logs(self) -> str:
        return "\n".join(
            f"{path.name}:\n" + "\n".join(path.read_text(errors="replace").splitlines()[-15:])
            for path in sorted(self.folder.glob("*.log"))
        )

    def close(self) -> None:
        """End all jobs, then the daemons, the last first."""
        for process in reversed(self.daemons):
            process.kill()
            process.wait()
        self.daemons.clear()
        for number in self.tasks():  # steps and tasks do not end with slurmd
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        shutil.rmtree(self.folder, ignore_errors=True)


def _free_ports(n: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        doors = [stack.enter_context(socket.socket()) for _ in range(n)]
        for door in doors:
            door.bind(("127.0.0.1", 0))
        return [door.getsockname()[1] for door in doors]
