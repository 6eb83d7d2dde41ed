//! The exchange format: evaluations against independent reference values, relaxation, and clear refusals.

use jamhpc::comm::Comm;
use jamhpc::exchange::{Configuration, Extra, evaluate, minimize};
use jamhpc::minimize::{Fire, Goal};
use serde_json::{Value, json};

const DISKS: &str = include_str!("cases/sp_n64_phi090.json");
const SHEARED: &str = include_str!("cases/dp_random_sheared.json");
const JAMMED: &str = include_str!("cases/dp_jammed_rho095.json");

const EXTRAS: &[Extra] = &[Extra::Voids, Extra::Moduli, Extra::Spectrum, Extra::Approximations];

fn parse(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

/// All numbers of a nested list, in order.
fn flat(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(flat).collect(),
        number => vec![number.as_f64().unwrap_or_else(|| panic!("not a number: {number}"))],
    }
}

/// Asserts that `key` (a JSON pointer) agrees to `tolerance`, relative to the largest number of the expected list
/// or to `floor`, whichever is larger.
fn agrees(got: &Value, got_key: &str, expected: &Value, key: &str, tolerance: f64, floor: f64) {
    let (x, y) = (flat(got.pointer(got_key).unwrap()), flat(expected.pointer(key).unwrap()));
    assert_eq!(x.len(), y.len(), "{key}");
    let scale = y.iter().fold(floor, |m: f64, v| m.max(v.abs()));
    for (i, (a, b)) in x.iter().zip(&y).enumerate() {
        assert!((a - b).abs() <= tolerance * scale, "{key}[{i}]: {a:e} against {b:e}");
    }
}

/// Evaluates a case; its answer and what is expected.
fn evaluated(case: &str) -> (Value, Value) {
    (parse(&evaluate(Comm::alone(), case, "case", EXTRAS).unwrap()), parse(case)["expected"].take())
}

#[test]
fn relaxed_soft_disks() {
    let (got, expected) = evaluated(DISKS);
    let same = |key: &str, tolerance| agrees(&got, key, &expected, key, tolerance, 0.0);
    same("/energy/total", 1e-11);
    agrees(&got, "/forces", &expected, "/forces", 1e-10, 1.0);
    agrees(&got, "/max_force", &expected, "/max_force", 1e-10, 1.0);
    same("/stress/virial", 1e-8);
    same("/pressure", 1e-8);
    same("/areas", 1e-12);
    same("/perimeters", 1e-12);
    same("/packing_fraction", 1e-12);
    same("/reduced_number_density", 1e-12);
    assert_eq!(got["contacts"].as_array().unwrap().len() as u64, expected["n_contacts"].as_u64().unwrap());
    assert_eq!(got["contact_number"], expected["contact_number"]);
    assert_eq!(got["rattlers"], expected["rattlers"]);
    assert_eq!(got["energy"]["pair"], got["energy"]["total"]);
    let (voids, expected_voids) = (got["voids"].as_array().unwrap(), expected["voids"].as_array().unwrap());
    assert_eq!(voids.len(), expected_voids.len());
    for (void, expected) in voids.iter().zip(expected_voids) {
        assert_eq!(void["sides"], expected["sides"]);
        agrees(void, "/area", expected, "/area", 1e-12, 1.0);
    }
    for key in ["/shear_modulus/linear_response", "/shear_modulus/affine", "/bulk_modulus"] {
        same(key, 1e-6);
    }
    assert_eq!(got["moduli"]["stability"], "stable");
    assert_eq!((&got["spectrum"]["n_zero"], &got["spectrum"]["n_negative"]), (&json!(2), &json!(0)));
    assert_eq!(got["void_statistics"]["all"]["fractions"][1], json!(29.0 / 91.0));
    let error = got["approximations"]["packing_fraction_eq9_eq10"]["error"].as_f64().unwrap();
    assert!(error < -0.1, "{error}");
    // the disks' shares tile their union
    let areas: f64 = flat(&got["areas"]).iter().sum();
    let cell = &parse(DISKS)["input"]["box"];
    let box_area = cell["lx"].as_f64().unwrap() * cell["ly"].as_f64().unwrap();
    assert!((areas / box_area - got["packing_fraction"].as_f64().unwrap()).abs() < 1e-14);
}

#[test]
fn deformable_particles_in_a_sheared_box() {
    let (got, expected) = evaluated(SHEARED);
    let same = |key: &str, tolerance| agrees(&got, key, &expected, key, tolerance, 0.0);
    for term in ["total", "line", "area", "contact"] {
        same(&format!("/energy/{term}"), 1e-11);
    }
    same("/forces", 1e-10);
    same("/max_force", 1e-10);
    same("/stress/virial", 1e-8);
    same("/stress/centroid", 1e-8);
    agrees(&got, "/areas", &expected, "/polygon_areas", 1e-12, 0.0);
    same("/perimeters", 1e-12);
    assert_eq!(got["contacts"].as_array().unwrap().len() as u64, expected["n_contacts"].as_u64().unwrap());
}

#[test]
fn jammed_deformable_particles() {
    let (got, expected) = evaluated(JAMMED);
    let same = |key: &str, tolerance| agrees(&got, key, &expected, key, tolerance, 0.0);
    for term in ["total", "line", "area"] {
        same(&format!("/energy/{term}"), 1e-11);
    }
    same("/energy/contact", 1e-8);
    agrees(&got, "/forces", &expected, "/forces", 1e-8, 1.0);
    agrees(&got, "/max_force", &expected, "/max_force", 1e-8, 1.0);
    same("/stress/virial", 1e-8);
    same("/stress/centroid", 1e-8);
    same("/pressure", 1e-8);
    agrees(&got, "/areas", &expected, "/polygon_areas", 1e-12, 0.0);
    same("/perimeters", 1e-12);
    agrees(&got, "/packing_fraction_double_counted", &expected, "/packing_fraction_with_shell", 1e-12, 0.0);
    // the shells of a relaxed packing overlap by 1e-5 of their width
    let rho = ["packing_fraction_double_counted", "packing_fraction"].map(|key| got[key].as_f64().unwrap());
    assert!((0.0..1e-4).contains(&(rho[0] - rho[1])), "{rho:?}");
    for key in ["/shear_modulus/linear_response", "/shear_modulus/affine"] {
        same(key, 1e-6);
    }
    assert_eq!(got["moduli"]["stability"], "stable");
    let borders = &got["void_statistics"]["all"];
    assert!(borders["border_radius_over_delta"].as_f64().unwrap() > 0.5);
    assert_eq!(got["contacts"].as_array().unwrap().len() as u64, expected["n_contacts"].as_u64().unwrap());
    assert_eq!(got["contact_number"], expected["contact_number"]);
}

/// The two ways to the shear modulus agree, or the evaluation fails.
#[test]
fn relaxed_strains_of_the_box() {
    let got = parse(&evaluate(Comm::alone(), DISKS, "case", &[Extra::QuasiStatic]).unwrap());
    let [linear, strained] =
        ["/shear_modulus/linear_response", "/quasi_static/shear_modulus"].map(|key| got.pointer(key).unwrap().as_f64());
    assert!((linear.unwrap() - strained.unwrap()).abs() < 1e-6 * linear.unwrap());
    assert!(got["quasi_static"]["difference"].as_f64().unwrap() < 1e-6);
    // forces of 10 are no balance
    let refused = evaluate(Comm::alone(), SHEARED, "case", &[Extra::QuasiStatic]).unwrap_err().to_string();
    assert!(refused.contains("not that of relaxed strains"), "{refused}");
}

/// States that are hardly any have defined answers, all of them numbers.
#[test]
fn states_at_the_edge_of_sense() {
    let disks = |at: Value, diameters: Value| json!({"model": "sp", "box": {"lx": 8, "ly": 8, "xy": 0}, "epsilon": 1, "diameters": diameters, "positions": at});
    // at rest: k_a (a0 - a) = gamma/R
    let square = json!([[1, 1], [2, 1], [2, 2], [1, 2]]);
    let polygon = json!({
        "model": "dp", "box": {"lx": 8, "ly": 8, "xy": 1}, "line_tension": 1, "k_area": 100, "epsilon": 10,
        "delta": 0.1, "contact": "vertex-edge", "n_vertices": [4], "a0": [1.02], "vertices": square
    });
    let row = |n: usize| json!((0..n).map(|k| [8.0 * k as f64 / n as f64, 1.0]).collect::<Vec<_>>());
    let ones = |n: usize| json!(vec![1.0; n]);
    for (what, state, percolating) in [
        ("a single disk", disks(json!([[1, 1]]), ones(1)), 1),
        ("a single polygon", polygon, 1),
        ("nothing touches", disks(json!([[1, 1], [4, 4], [6, 1]]), ones(3)), 1),
        ("all are rattlers, and unbalanced", disks(json!([[1, 1], [1.9, 1], [2.7, 1]]), ones(3)), 1),
        ("a row around the box, and unstable", disks(row(9), ones(9)), 1),
    ] {
        let got = parse(&evaluate(Comm::alone(), &state.to_string(), "case", EXTRAS).unwrap());
        assert_eq!(got["contact_number"], 0.0, "{what}");
        let n = got["areas"].as_array().unwrap().len();
        assert_eq!(got["rattlers"].as_array().unwrap().len(), n, "{what}: N' = 0");
        assert_eq!(got["void_statistics"]["all"]["n_percolating"], percolating, "{what}");
        // without any particle there are no voids to tell of
        assert!(got["void_statistics"]["without_rattlers"].is_null(), "{what}");
        let g = got.pointer("/shear_modulus/linear_response").unwrap().as_f64().unwrap();
        assert!(g.abs() < 1e-9, "{what}: G = {g}");
        // JSON has no other word for NaN
        let mut text = got.to_string();
        // what has no meaning for disks, or without any particle
        for none in ["\"border_radius_over_delta\":null", "\"without_rattlers\":null"] {
            text = text.replace(none, "");
        }
        assert!(!text.contains("null"), "{what}: {text}");
    }
    // forces of 10: moduli say that they mean nothing
    let unbalanced = parse(&evaluate(Comm::alone(), SHEARED, "case", EXTRAS).unwrap());
    assert_eq!(unbalanced["moduli"]["stability"], "unstable");
}

#[test]
fn the_answer_has_the_promised_keys_and_no_others() {
    let keys = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    let plain = |case| parse(&evaluate(Comm::alone(), case, "case", &[]).unwrap());
    let (disks, polygons) = (plain(DISKS), plain(SHEARED));
    let promised = [
        "areas",
        "contact_number",
        "contacts",
        "energy",
        "forces",
        "max_force",
        "packing_fraction",
        "packing_fraction_double_counted",
        "perimeters",
        "pressure",
        "rattlers",
        "reduced_number_density",
        "shape_parameter",
        "stress",
    ];
    for answer in [&disks, &polygons] {
        assert_eq!(keys(answer), promised);
        assert_eq!(keys(&answer["stress"]), ["centroid", "virial"]);
        assert_eq!(keys(&answer["shape_parameter"]), ["polygon", "relative", "shell"]);
    }
    assert_eq!(keys(&disks["energy"]), ["pair", "total"]);
    assert_eq!(keys(&polygons["energy"]), ["area", "contact", "line", "total"]);
    let largest = flat(&polygons["forces"]).chunks(2).map(|f| f[0].hypot(f[1])).fold(0.0, f64::max);
    assert!((polygons["max_force"].as_f64().unwrap() - largest).abs() <= 1e-12 * largest);
}

#[test]
fn the_input_may_stand_alone() {
    let mut alone = parse(SHEARED)["input"].take();
    let answer = evaluate(Comm::alone(), SHEARED, "case", &[]).unwrap();
    assert_eq!(evaluate(Comm::alone(), &alone.to_string(), "case", &[]).unwrap(), answer);
    alone["note"] = json!("anything");
    alone.as_object_mut().unwrap().remove("contact");
    assert_eq!(evaluate(Comm::alone(), &alone.to_string(), "case", &[]).unwrap(), answer);
}

#[test]
fn configurations_survive_writing() {
    for case in [DISKS, SHEARED, JAMMED] {
        let configuration = Configuration::read(case).unwrap();
        let text = serde_json::to_string(&configuration).unwrap();
        assert_eq!(Configuration::read(&text).unwrap(), configuration);
        assert_eq!(parse(&text), parse(case)["input"]);
    }
}

/// Text of a small configuration of disks.
fn three_disks() -> Value {
    json!({"model": "sp", "box": {"lx": 6.0, "ly": 5.0, "xy": 0.5}, "epsilon": 1.0,
           "diameters": [1.0, 1.4, 1.0], "positions": [[1.0, 1.0], [1.8, 1.2], [8.1, 6.0]]})
}

/// Text of two squares.
fn two_squares() -> Value {
    json!({"model": "dp", "box": {"lx": 6.0, "ly": 5.0, "xy": 0.0},
           "line_tension": 1.0, "k_area": 100.0, "epsilon": 50.0, "delta": 0.2, "contact": "vertex-edge",
           "n_vertices": [4, 4], "a0": [1.0, 1.0],
           "vertices": [[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0], [2.1, 1.3], [3.1, 1.3], [3.1, 2.3], [2.1, 2.3]]})
}

#[test]
fn relaxation_ends_in_force_balance() {
    let goal = Goal { force_tolerance: 1e-11, max_iterations: 100_000 };
    for start in [three_disks(), two_squares()] {
        let (text, minimized) = minimize(Comm::alone(), &start.to_string(), "start", &Fire, &goal).unwrap();
        assert!(minimized.is_converged());
        let relaxed = parse(&text);
        let report = &relaxed["minimize"];
        assert_eq!(report["converged"], json!(true));
        assert_eq!(report["iterations"].as_u64().unwrap(), minimized.report().iterations);
        assert!(report["max_force"].as_f64().unwrap() <= 1e-11);
        assert!(report["force_evaluations"].as_u64().unwrap() > 0);
        // the result is an input again
        let again = parse(&evaluate(Comm::alone(), &text, "relaxed", &[]).unwrap());
        assert!(again["max_force"].as_f64().unwrap() < 1e-9);
        let (before, after) = (report["energy"].as_f64().unwrap(), again["energy"]["total"].as_f64().unwrap());
        assert!((before - after).abs() <= 1e-12 * before.max(1.0));
        for key in ["model", "box", "epsilon"] {
            assert_eq!(relaxed[key], start[key]);
        }
    }
}

/// In this box the nearest image of disk 1 seen from disk 0 is not the one that lists find first, and disk 2 pushes the
/// two together.
#[test]
fn disks_of_a_tilted_box_touch_through_their_nearest_images() {
    let text = r#"{"model": "sp", "box": {"lx": 3.23, "ly": 3.23, "xy": 1.6}, "epsilon": 1.0, "diameters": [1.4, 1.4, 1.0],
        "positions": [[0, 0], [-1.3273, 0.646], [-2.226458728630794, 1.0836226464970187]]}"#;
    let goal = Goal { force_tolerance: 1e-12, max_iterations: 100_000 };
    let (relaxed, outcome) = minimize(Comm::alone(), text, "test", &Fire, &goal).unwrap();
    assert!(outcome.is_converged());
    let evaluation = parse(&evaluate(Comm::alone(), &relaxed, "relaxed", &[]).unwrap());
    assert!(evaluation["max_force"].as_f64().unwrap() <= 1e-12, "{evaluation}");
}

#[test]
fn edges_too_long_for_their_box_are_refused() {
    // the middle of an edge of 1.95 is touched; in the small box the vertex is nearer to another image of its start
    let triangles = |edge: f64| {
        let text = json!({
            "model": "dp", "box": {"lx": edge, "ly": edge, "xy": 0.0}, "line_tension": 1.0, "k_area": 100.0,
            "epsilon": 10.0, "delta": 0.3, "contact": "vertex-edge", "n_vertices": [3, 3], "a0": [0.5, 0.5],
            "vertices": [[0, 0], [1.95, 0], [1, 0.5], [2.2, 0.0], [3.2, -0.3], [3.2, 0.3]]
        });
        text.to_string()
    };
    let message = refusal(&triangles(4.0));
    assert!(message.contains("edges as long as 1.9500") && message.contains("wider than 4.5000"), "{message}");
    let energy = |edge| parse(&evaluate(Comm::alone(), &triangles(edge), "case", &[]).unwrap())["energy"].take();
    let (contact, exact) = (energy(4.6)["contact"].as_f64().unwrap(), 10.0 * (1.0f64 - 0.25 / 0.3).powi(2));
    assert!((contact - exact).abs() < 1e-12 * exact, "{contact}");
    let flat = triangles(8.0).replace("[1,0.5]", "[1,0]");
    assert!(refusal(&flat).contains("particle 0 has no area"), "{}", refusal(&flat));
}

#[test]
fn a_relaxation_that_runs_out_of_steps_says_so() {
    let goal = Goal { force_tolerance: 1e-11, max_iterations: 3 };
    let start = two_squares().to_string();
    let (text, minimized) = minimize(Comm::alone(), &start, "start", &Fire, &goal).unwrap();
    assert!(!minimized.is_converged());
    assert_eq!(parse(&text)["minimize"]["converged"], json!(false));
}

/// The message that refuses a text.
fn refusal(text: &str) -> String {
    evaluate(Comm::alone(), text, "bad.json", &[]).expect_err(text).to_string()
}

#[test]
fn texts_that_are_no_configuration() {
    for (text, says) in [
        ("", "bad.json: the file is empty: give one JSON object"),
        ("  \n", "the file is empty"),
        ("model = \"sp\"", "this is not JSON: expected value at line 1 column 1"),
        ("{\"model\": \"sp\",}", "this is not JSON: trailing comma"),
        ("{\"model\": NaN}", "JSON has no NaN"),
        ("{\"model\": 1e999}", "this is not JSON: number out of range"),
        ("[1, 2]", "`the top level` must be an object, but is a list of 2"),
        ("{}", "`model` is missing: add \"sp\" or \"dp\""),
        ("{\"model\": \"SP\"}", "`model` must be \"sp\" or \"dp\", but is \"SP\""),
        ("{\"input\": 3}", "`input` must be an object, but is 3"),
        ("{\"model\": \"sp\"}", "`box` is missing: add an object with the keys lx, ly, xy"),
    ] {
        let message = refusal(text);
        assert!(message.contains(says), "{message:?} does not say {says:?}");
        assert!(!message.contains('\n'));
    }
}

#[test]
fn configurations_with_one_mistake() {
    let table: Vec<(Value, &str, Value, &str)> = vec![
        // start, pointer to what is replaced (null removes it), replacement, what the message says
        (three_disks(), "/diameter", json!([1.0]), "unknown key `diameter`, did you mean `diameters`?"),
        (three_disks(), "/gravity", json!(9.8), "unknown key `gravity`; accepted here: model, box, epsilon, diameters"),
        (three_disks(), "/box/lz", json!(1.0), "unknown key `box.lz`, did you mean `box.lx`?"),
        (three_disks(), "/vertices", json!([]), "unknown key `vertices`"),
        (three_disks(), "/diameters", json!(null), "`diameters` is missing: add a list"),
        (three_disks(), "/epsilon", json!("1.0"), "`epsilon` must be a number greater than 0"),
        (
            three_disks(),
            "/epsilon",
            json!(0.0),
            "`epsilon` must be a number greater than 0 (1e-30 to 1e30), but is 0.0",
        ),
        (
            three_disks(),
            "/box",
            json!([6.0, 5.0]),
            "`box` must be an object with the keys lx, ly, xy, but is a list of 2",
        ),
        (
            three_disks(),
            "/box/lx",
            json!(-6.0),
            "`box.lx` must be a number greater than 0 (1e-30 to 1e30), but is -6.0",
        ),
        (three_disks(), "/box/ly", json!(null), "`box.ly` is missing"),
        (three_disks(), "/box/xy", json!("0"), "`box.xy` must be a finite number"),
        (three_disks(), "/diameters/1", json!(0), "`diameters[1]` must be a number greater than 0"),
        (three_disks(), "/diameters", json!([1.0, 1.4]), "`positions` has 3 entries, but must have 2"),
        (three_disks(), "/positions/2", json!([1.0]), "`positions[2]` must be a point [x, y], but is a list of 1"),
        (three_disks(), "/positions/0/1", json!(true), "`positions[0][1]` must be a finite number"),
        (three_disks(), "/diameters/1", json!(4.0), "meets its own periodic image"),
        (
            two_squares(),
            "/contact",
            json!("edges"),
            "`contact` must be \"vertex-edge\" or \"edge-edge\", but is \"edges\"",
        ),
        (two_squares(), "/line_tension", json!(-1.0), "`line_tension` must be a number not below 0"),
        (two_squares(), "/delta", json!(null), "`delta` is missing"),
        (
            two_squares(),
            "/n_vertices/0",
            json!(2),
            "`n_vertices[0]` must be a whole number from 3 to 1000000, but is 2",
        ),
        (two_squares(), "/n_vertices/0", json!(4.5), "`n_vertices[0]` must be a whole number"),
        (two_squares(), "/n_vertices/0", json!(5), "`vertices` has 8 entries, but must have 9"),
        (
            two_squares(),
            "/a0",
            json!([1.0]),
            "`a0` has 1 entries, but must have 2: one rest area for each of `n_vertices`",
        ),
        (two_squares(), "/a0/1", json!(-1.0), "`a0[1]` must be a number greater than 0"),
        (
            two_squares(),
            "/vertices/5",
            json!([-2.9, 1.3]),
            "vertices 0 and 1 of particle 1 (counted from 0) are half a box",
        ),
        (two_squares(), "/vertices/4", json!([1.9, 1.3]), "the outlines of particles 0 and 1 cross"),
        (two_squares(), "/vertices/6", json!([2.0, 1.9]), "the outline of particle 1 crosses itself"),
        (two_squares(), "/delta", json!(4.0), "meets its own periodic image"),
    ];
    for (mut value, pointer, replacement, says) in table {
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        let parent = value.pointer_mut(parent).unwrap();
        match parent {
            Value::Object(map) if replacement.is_null() => drop(map.remove(key)),
            Value::Object(map) => drop(map.insert(key.to_string(), replacement)),
            Value::Array(list) => list[key.parse::<usize>().unwrap()] = replacement,
            _ => unreachable!(),
        }
        let message = refusal(&value.to_string());
        assert!(message.contains(says), "{message:?} does not say {says:?}");
        assert!(message.starts_with("bad.json: ") && !message.contains('\n'));
    }
}

#[test]
fn lists_and_outlines_as_a_whole() {
    let mut empty = three_disks();
    empty["diameters"] = json!([]);
    empty["positions"] = json!([]);
    assert!(
        refusal(&empty.to_string()).contains("`diameters` must be a list with at least one particle, but is empty")
    );

    let mut clockwise = two_squares();
    clockwise["vertices"].as_array_mut().unwrap()[4..].reverse();
    assert!(refusal(&clockwise.to_string()).contains("the vertices of particle 1 run clockwise"));

    let mut nested = two_squares();
    nested["vertices"].as_array_mut().unwrap().truncate(4);
    nested["vertices"]
        .as_array_mut()
        .unwrap()
        .extend([[1.3, 1.3], [1.5, 1.3], [1.5, 1.5], [1.3, 1.5]].map(|v: [f64; 2]| json!(v)));
    assert!(refusal(&nested.to_string()).contains("particles 0 and 1 cross, or one lies inside the other"));
}
