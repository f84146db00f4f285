"""Find out which program wrote a file, from its beginning, and read the histograms or samples in it."""

from collections.abc import Sequence
from pathlib import Path

from rtfiles.errors import UsageError
from rtfiles.untrusted import MIB, read_bytes
from rtrun.results.importers import cyclictest, cyclictest_samples, jitterdebugger, rteval, timerlat
from rtrun.results.importers.given import NOTHING_GIVEN, Given
from rtrun.results.importers.histogram_file import Imported
from rtrun.results.importers.samples_file import ImportedSamples
from rtrun.results.importers.unreadable import recognise

MAX_BYTES = 16 * MIB  #: a file that is imported
READS = (
    "a log of 2014 or of a suite, cyclictest -h, -v or --json, jitterdebugger's results.json, rtla timerlat hist, "
    "rteval's summary.xml"
)


def read(path: Path, given: Given = NOTHING_GIVEN) -> Sequence[Imported | ImportedSamples]:
    """Read the histograms in a file of another program, or the samples of cyclictest -v, one per thread.

    `given` is what the user states about the file. Raises UsageError ``file[:line]: what is wrong``.
    """
    return tuple(given.complete(path, imported) for imported in _read(path, given))


def _read(path: Path, given: Given) -> Sequence[Imported | ImportedSamples]:
    if cyclictest_samples.has_samples(path):
        return cyclictest_samples.read_samples(path, unit_ns=given.unit_ns)
    try:
        text = read_bytes(path, max_bytes=MAX_BYTES).decode("utf-8")
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not text, expected {READS}") from error
    is_json = text.lstrip().startswith("{")
    if is_json and (imported := cyclictest.read_json_results(path, text)) is not None:
        return imported
    if not is_json and "# Histogram" in text:
        return cyclictest.read_text(path, text, unit_ns=given.unit_ns)
    if not is_json and "RTLA timerlat histogram" in text:
        return timerlat.read_text(path, text)
    if rteval.is_report(text):
        return rteval.read_report(path, text)
    if kind := recognise(text):
        raise UsageError(f"{path}: {kind}")
    if is_json:
        return jitterdebugger.read_results(path, text)
    raise UsageError(f"{path}: expected {READS}")
