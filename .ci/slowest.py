"""Print the slowest tests of pytest's JUnit reports: python .ci/slowest.py COUNT REPORT..."""

import sys
from pathlib import Path
from xml.etree import ElementTree

count, reports = int(sys.argv[1]), map(Path, sys.argv[2:])
cases = [case for report in reports if report.exists() for case in ElementTree.parse(report).iter("testcase")]
for case in sorted(cases, key=lambda case: -float(case.get("time", 0)))[:count]:
    print(f"{float(case.get('time', 0)):8.1f} s  {case.get('classname')}::{case.get('name')}")
print(f"{len(cases):8} tests, {sum(float(case.get('time', 0)) for case in cases):.0f} s of all processes together")
