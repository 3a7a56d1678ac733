"""Shows `t2m_jax` a standard library like that of Windows. Import this before `t2m_jax`.

Modules of the package do not get what only other systems have. In the whole process, folders are neither opened nor
replaced, and files that are open are neither deleted nor replaced.
"""

import builtins
import ctypes
import errno
import os
import types
import warnings
from pathlib import Path

MISSING = {
    "os": "chown fchmod fchown fork getegid geteuid getgid getgroups getloadavg getpgid getuid killpg lchown mkfifo"
    " mknod nice pathconf posix_fadvise posix_fallocate pread pwrite sched_getaffinity sched_setaffinity"
    " sendfile setgid setsid setuid statvfs sync sysconf sysconf_names uname wait wait3 wait4 O_CLOEXEC"
    " O_DIRECT O_DIRECTORY O_NOATIME O_NOFOLLOW O_NONBLOCK O_PATH O_SYNC O_TMPFILE WNOHANG",
    "signal": "SIGALRM SIGBUS SIGCHLD SIGCONT SIGHUP SIGKILL SIGPIPE SIGQUIT SIGSTOP SIGTSTP SIGUSR1 SIGUSR2 SIGXCPU"
    " alarm pause pthread_kill pthread_sigmask setitimer sigtimedwait sigwait siginterrupt",
    "time": "tzset clock_gettime",
    "mmap": "MADV_DONTNEED MAP_SHARED MAP_PRIVATE PROT_READ PROT_WRITE",
}
"""Names by module."""
MODULES = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}


def refuse(path, reason):
    raise PermissionError(errno.EACCES, reason, os.fspath(path))


def is_open(path) -> bool:
    """Returns whether this process has a file, or one in a folder, open."""
    place = os.path.abspath(path)
    for descriptor in Path("/proc/self/fd").iterdir():
        if descriptor.is_symlink():  # the one that lists this folder is closed by now
            name = os.readlink(descriptor)
            if name == place or name.startswith(place + os.sep):
                return True
    return False


def when_closed(function):
    """Returns a function of `os` that deletes or renames, without what Windows refuses."""

    def run(path, *args, **options):
        if options.get("dir_fd") is None:
            if is_open(path):
                refuse(path, "it is open")
            if args and (os.path.isdir(args[0]) or is_open(args[0])):
                refuse(args[0], "it is a folder, or it is open")
        return function(path, *args, **options)

    return run


def open_file(path, flags, *args):
    if os.path.isdir(path):
        refuse(path, "it is a folder")
    return os.open(path, flags, *args)


def load_library(name, *args, **options):
    if name is None:
        raise TypeError("there is no library of the process itself")
    return ctypes.CDLL(name, *args, **options)


def copy_module(name: str, /, **changes) -> types.ModuleType:
    """Returns a module of the standard library without what Windows does not have."""
    original = __import__(name)
    copy = types.ModuleType(name)
    missing = MISSING.get(name, "").split()
    vars(copy).update({key: value for key, value in vars(original).items() if key not in missing} | changes)
    return copy


def imitate_windows() -> None:
    copies = {name: copy_module(name) for name in MISSING}
    copies["os"] = copy_module("os", name="nt", open=open_file)
    copies["ctypes"] = copy_module("ctypes", CDLL=load_library)
    original = builtins.__import__

    def import_for(name, variables=None, *args, **options):
        if ((variables or {}).get("__name__") or "").startswith("t2m_jax"):
            if name in MODULES:
                raise ModuleNotFoundError(f"No module named {name!r}")
            if name in copies:
                return copies[name]
        return original(name, variables, *args, **options)

    builtins.__import__ = import_for
    for name in ("remove", "unlink", "rename", "replace"):
        setattr(os, name, when_closed(getattr(os, name)))
    # Python warns of files that are opened with the encoding of the system (with -X warn_default_encoding).
    warnings.filterwarnings("ignore", category=EncodingWarning)
    warnings.filterwarnings("error", category=EncodingWarning, module=r"t2m_jax\b")


imitate_windows()
