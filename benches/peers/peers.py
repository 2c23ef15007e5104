"""Measures our solver beside others on the same instances in one run; benches/peers/run calls it with everything in place."""
import argparse
import datetime
import json
import os
import platform
import re
import subprocess
import sys
import tempfile

import casadi as ca
import numpy as np

import casadi_rows

TRAJECTORIES = ["line", "sine", "lemniscate"]
SETS = {
    "paper": "The paper's problem, eq (20), N = 10",
    "lag-20": "The formulation that ships, model `centre`, N = 20",
}
ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
PAGE = os.path.join(ROOT, "docs", "peers.md")
BEGIN, END = "<!-- measured: written by benches/peers/run -->", "<!-- end of what was measured -->"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runner", required=True, help="the Rust side, built")
    parser.add_argument("--work", required=True, help="folder for results")
    parser.add_argument("--passes", type=int, default=5, help="passes of every row; of each instance the least time counts (5)")
    parser.add_argument("--sets", default="paper", help=f"which problems, of {','.join(SETS)} (paper)")
    parser.add_argument("--dry", action="store_true", help="print only: docs/peers.md stays as it is")
    arguments = parser.parse_args()

    # Some solvers greet on the standard output, which is for the tables.
    tables = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    head = {**machine(), "passes": arguments.passes, "command": "benches/peers/run " + " ".join(own_arguments())}
    load = [os.getloadavg()[0]]
    with tempfile.TemporaryDirectory(prefix="peers-") as folder:
        call([arguments.runner, "record", folder])
        os.chdir(folder)
        results = [
            result
            for name in arguments.sets.split(",")
            for result in measure(arguments, folder, name)
        ]
        os.chdir(ROOT)
    load.append(os.getloadavg()[0])

    head["load"] = load
    with open(os.path.join(arguments.work, "peers.json"), "w") as file:
        json.dump({"head": head, "results": results}, file, indent=1)
    text = page(head, results)
    with open(os.path.join(arguments.work, "peers.md"), "w") as file:
        file.write(text)
    tables.write(text)
    tables.flush()
    if not arguments.dry:
        rewrite(text)


def measure(arguments, folder, name):
    """All trajectories of one set: passes in which every row takes its turn."""
    data = {t: casadi_rows.Instances(os.path.join(folder, f"{name}-{t}.json")) for t in TRAJECTORIES}
    compiled = os.path.join(arguments.work, "compiled")
    os.makedirs(compiled, exist_ok=True)
    rows, left_out = [], []
    for row in casadi_rows.rows() + [casadi_rows.tight()]:
        if row.shooting == "single" and name != "paper":
            left_out.append({"name": f"{row.name} on {name}", "why": "its Hessian is 4 MB of C, minutes to compile"})
            continue
        try:
            row.build(data["line"], compiled, name.replace("-", "_"))
            rows.append(row)
        except Exception as error:
            left_out.append({"name": row.name, "why": str(error).strip().splitlines()[-1][:200]})
            print(f"{name}: without {row.name}: {left_out[-1]['why']}", file=sys.stderr)
    missing = {BASE, casadi_rows.tight().name} - {row.name for row in rows}
    if missing:
        sys.exit(f"cannot compare without {', '.join(sorted(missing))}: {left_out}")
    tight = rows.pop()
    passes = {t: {} for t in TRAJECTORIES}
    for number in range(arguments.passes):
        for t in TRAJECTORIES:
            print(f"{name}: pass {number + 1} of {arguments.passes}, {t}", file=sys.stderr)
            found = json.loads(call([arguments.runner, "rows", name, t]))
            for row in rows:
                row.model.data = data[t]
                found.append(row.run(range(len(data[t].p))))
                print(f"  {row.name}", file=sys.stderr, flush=True)
            for one in found:
                passes[t].setdefault(one["name"], []).append(one)
    for t in TRAJECTORIES:
        tight.model.data = data[t]
        reference = tight.run(range(len(data[t].p)))
        yield judged(arguments.runner, name, t, passes[t], reference, left_out)


def judged(runner, name, trajectory, passes, tight, left_out):
    """The figures of every row, its inputs compared with the tightest solution there is."""

    def residuals(u):
        points = json.dumps(np.asarray(u).tolist())
        return np.array([np.inf if r is None else r for r in json.loads(call([runner, "judge", name, trajectory], points))])

    ours = next(one[0] for row, one in passes.items() if row == "ours")
    candidates = {"ours": np.array(ours["u"]), "ipopt to 1e-12": np.array(tight["u"])}
    worst = {who: float(residuals(u).max()) for who, u in candidates.items()}
    who = min(worst, key=worst.get)
    reference = candidates[who]
    figures = []
    for row, ran in passes.items():
        solved = np.array(ran[0]["solved"])
        # The first instance is a cold start for everybody: solved, compared, not timed. Only solved ones have a time.
        times = np.min([one["times"] for one in ran], axis=0)
        timed = solved.copy()
        timed[0] = False
        u = np.array(ran[0]["u"])
        # By instance, so that a row is not judged by one that it says it failed on. Nor are our rows judged by ours.
        against = candidates["ipopt to 1e-12"] if row.startswith("ours") else reference
        off = np.abs(u - against).max(axis=(1, 2))
        figures.append(
            {
                "name": row,
                "median_us": float(np.median(times[timed])) if timed.any() else None,
                "p99_us": float(np.percentile(times[timed], 99)) if timed.any() else None,
                "iterations": float(np.mean(np.array(ran[0]["iterations"])[timed])) if timed.any() else None,
                "solved": float(solved.mean()),
                "off": float(off[solved].max()) if solved.any() else None,
                "off_median": float(np.median(off[solved])) if solved.any() else None,
                "residual": float(residuals(u)[solved].max()) if solved.any() else None,
            }
        )
    return {
        "set": name,
        "trajectory": trajectory,
        "instances": len(tight["u"]),
        "reference": who,
        "residuals": worst,
        "left_out": left_out,
        "rows": figures,
    }


def page(head, results):
    """The tables as Markdown, with what they were measured on."""
    lines = [
        f"Measured {head['date']} on {head['processor']} ({head['cores']} cores), {head['system']}; commit {head['commit']}; "
        f"{', '.join(head['versions'])}. One core, {head['passes']} pass{'es' if head['passes'] > 1 else ''} in which all rows take turns, of each instance the least time. "
        f"Load average {head['load'][0]:.1f} before and {head['load'][1]:.1f} after"
        + (": **the machine was shared**, so ratios are worth more than times." if max(head["load"]) > 1.5 else ".")
        + f" Command: `{head['command'].strip()}`.",
    ]
    for result in results:
        base = next(row for row in result["rows"] if row["name"] == BASE)
        residuals = ", ".join(f"{who} {value:.0e}" for who, value in result["residuals"].items())
        lines += [
            "",
            f"**{SETS[result['set']]}: {result['trajectory']}**, {result['instances']} instances. "
            f"Δu is counted from {result['reference']}, that of our rows from ipopt to 1e-12 (largest KKT residual: {residuals}).",
            "",
            "| solver | median [µs] | p99 [µs] | times faster than the paper's, median | iterations | solved | largest \\|Δu\\| | KKT residual |",
            "|---|---|---|---|---|---|---|---|",
        ]
        for row in sorted(result["rows"], key=lambda row: row["median_us"] or np.inf):
            if row["median_us"] is None:
                lines.append(f"| {row['name']} | – | – | – | – | 0 % | – | – |")
                continue
            ratio = base["median_us"] / row["median_us"]
            mark = "**" if row["name"].startswith("ours") else ""
            lines.append(
                f"| {mark}{row['name']}{mark} | {digits(row['median_us'])} | {digits(row['p99_us'])} | {mark}{digits(ratio)}{mark} | "
                f"{row['iterations']:.1f} | {100 * row['solved']:.4g} % | {row['off']:.0e} | {row['residual']:.0e} |"
            )
    left_out = {(one["name"], one["why"]) for result in results for one in result["left_out"]}
    lines += [""] + [f"Not measured: {name} ({why})." for name, why in sorted(left_out)]
    return "\n".join(lines).strip() + "\n"


def digits(value):
    """Three digits at most."""
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def rewrite(text):
    with open(PAGE) as file:
        before = file.read()
    head, _, rest = before.partition(BEGIN)
    _, _, tail = rest.partition(END)
    if not rest or not tail:
        sys.exit(f"{PAGE} has lost its markers: {BEGIN} and {END}")
    with open(PAGE, "w") as file:
        file.write(f"{head}{BEGIN}\n{text}{END}{tail}")


def machine():
    with open(os.path.join(ROOT, "benches/peers/Cargo.lock")) as file:
        lock = file.read()
    def crate(name):
        return f"{name} " + re.search(rf'name = "{name}"\nversion = "([0-9.]+)"', lock)[1]

    processor = next((line.split(":")[1].strip() for line in lines_of("/proc/cpuinfo") if line.startswith("model name")), platform.processor())
    return {
        "date": datetime.date.today().isoformat(),
        "processor": processor,
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "commit": call(["git", "-C", ROOT, "describe", "--always", "--dirty", "--abbrev=10"]).strip(),
        "versions": [
            call(["rustc", "--version"]).split(" (")[0],
            call(["cc", "--version"]).splitlines()[0],
            f"CasADi {ca.__version__}",
            f"Clarabel and OSQP from crates {crate('clarabel')}, {crate('osqp')}",
        ],
    }


def lines_of(path):
    try:
        with open(path) as file:
            return file.readlines()
    except OSError:
        return []


def own_arguments():
    """The arguments that the caller of `run` gave."""
    return [a for i, a in enumerate(sys.argv[1:]) if i >= 4]


def call(command, text=None):
    return subprocess.run(command, input=text, check=True, stdout=subprocess.PIPE, text=True).stdout


BASE = "CasADi sqpmethod + qpOASES"

if __name__ == "__main__":
    main()
