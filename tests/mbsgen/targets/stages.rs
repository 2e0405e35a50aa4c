// Reads problems from the standard input, and writes what the stages of generated crates compute of them.
#![allow(non_snake_case, dead_code)]
mod math {
    pub type Real = f64;
    pub const SHORT: Real = 1e-8;
    pub fn abs(x: Real) -> Real {
        x.abs()
    }
}
mod stages;

use std::io::Read;

fn main() {
    let mut text = String::new();
    std::io::stdin().read_to_string(&mut text).unwrap();
    for line in text.lines() {
        let mut words = line.split_whitespace();
        let kind = words.next().unwrap();
        let mut whole = || words.next().unwrap().parse::<usize>().unwrap();
        let (n, width, branches) = (whole(), whole(), whole());
        let starts: Vec<u32> = (0..n + 1).map(|_| whole() as u32).collect();
        let ancestors: Vec<u32> = (0..branches).map(|_| whole() as u32).collect();
        let mut numbers = words.map(|word| word.parse::<f64>().unwrap());
        let threshold = numbers.next().unwrap();
        let mut A: Vec<f64> = numbers.by_ref().take(n * n).collect();
        let mut B: Vec<f64> = numbers.collect();
        let (mut scales, mut exchanges) = (vec![0.0; n], vec![0i32; n]);
        let (mut lower, mut inverses) = (vec![0.0; branches], vec![0.0; n]);
        let is_regular = match kind {
            "tree" => stages::factorise_tree(
                n, &starts, &ancestors, threshold, &mut A, &mut scales, &mut lower, &mut inverses,
            ),
            "symmetric" => stages::factorise_symmetric(n, threshold, &mut A, &mut scales, &mut exchanges),
            "step" => stages::step(&A[..n].to_vec(), &mut B).0,
            _ => stages::factorise_general(n, threshold, &mut A, &mut scales, &mut exchanges),
        };
        if is_regular {
            match kind {
                "tree" => stages::solve_tree(n, &starts, &ancestors, &lower, &inverses, width, &mut B),
                "symmetric" => stages::solve_symmetric(n, &A, &exchanges, width, &mut B),
                "transposed" => stages::solve_transposed(n, &A, &exchanges, width, &mut B),
                "general" => stages::solve_general(n, &A, &exchanges, width, &mut B),
                _ => {}
            }
        }
        let exchanges: Vec<String> = exchanges.iter().map(|k| k.to_string()).collect();
        let found: Vec<String> = B.iter().map(|x| format!("{:e}", x)).collect();
        println!("{};{};{}", is_regular, exchanges.join(" "), found.join(" "));
    }
}
