import json
import sys
import warnings

from hhtbench.conformance import check_solver
from hhtbench.processes import one_blas_thread
from tests.conformance.claims import CLAIMS, claims_of

one_blas_thread()
warnings.simplefilter("ignore")
base = json.load(open("/tmp/conf1_base/claims.json"))
want = sys.argv[1].split(",")
name = {"right": "passed", "wrong": "failed", "crashed": "failed"}
for spec in sys.argv[2:] or CLAIMS:
    n = 0
    for c in check_solver(spec, **claims_of(spec)):
        if want != ["all"] and c.name.split("/")[0] not in want:
            continue
        r = c.run()
        k = name.get(r.kind.name, r.kind.name)
        o = base[spec].get(c.name)
        n += 1
        if o is None:
            if k != "passed":
                print("  new", spec, c.name, k, r.message[:120])
        elif o[0] != k:
            print("  DIFF", spec, c.name, o, k, r.message[:200])
    print(spec, n, flush=True)
