//! A swarm by Zenoh: `cargo run -- meadow list`, `... vote teacher 2`, `... stop tb3-01 tb3-02`
use rmpv::{decode::read_value, encode::write_value, Value};
use std::{collections::BTreeSet, env, thread::sleep, time::Duration, time::Instant};
use zenoh::{query::QueryTarget, Config, Result, Session, Wait};

// Robots are found one by one: the most that is waited for them; and the time without a new name
// after which all count as found.
const LIMIT: Duration = Duration::from_secs(5);
const QUIET: Duration = Duration::from_secs(1);

fn payload(content: Value) -> Result<Vec<u8>> {
    let mut bytes = vec![1]; // the version of the format; MessagePack follows
    Ok(write_value(&mut bytes, &content).map(|()| bytes)?)
}

fn names(session: &Session, swarm: &str) -> Result<BTreeSet<String>> {
    let replies = session.liveliness().get(format!("swarm/{swarm}/*")).wait()?;
    let tokens = replies.into_iter().filter_map(|reply| reply.into_result().ok());
    Ok(tokens.filter_map(|token| token.key_expr().rsplit('/').next().map(String::from)).collect())
}

fn list(session: &Session, swarm: &str) -> Result<()> {
    let (start, mut newest, mut known) = (Instant::now(), Instant::now(), BTreeSet::new());
    while if known.is_empty() { start.elapsed() < LIMIT } else { newest.elapsed() < QUIET } {
        for name in names(session, swarm)? {
            if known.insert(name.clone()) {
                println!("{name}");
                newest = Instant::now();
            }
        }
        sleep(Duration::from_millis(100));
    }
    (!known.is_empty()).then_some(()).ok_or(format!("no robot of {swarm} was found").into())
}

fn vote(session: &Session, swarm: &str, program: &str, opinion: i64) -> Result<()> {
    let own = format!("swarm/{swarm}/{program}");
    let _token = session.liveliness().declare_token(&own).wait()?;
    let publisher = session.declare_publisher(own + "/message/voter_model/opinion").wait()?;
    loop {
        publisher.put(payload(opinion.into())?).wait()?;
        sleep(Duration::from_millis(500));
    }
}

/// The robots that are `named` must answer; without names, each name with a token.
fn stop(session: &Session, swarm: &str, named: &[&str]) -> Result<()> {
    let id = session.zid().to_string(); // a new one for each request
    let mut wanted: BTreeSet<String> = named.iter().map(|name| name.to_string()).collect();
    let (start, mut newest, mut answered) = (Instant::now(), Instant::now(), BTreeSet::new());
    loop {
        let is_done = !wanted.is_empty() && wanted.is_subset(&answered);
        let is_settled = !named.is_empty() || newest.elapsed() > QUIET;
        if start.elapsed() > LIMIT || (is_done && is_settled) {
            break;
        }
        let found = names(session, swarm)?;
        if named.is_empty() && !found.is_subset(&wanted) {
            wanted.extend(found);
            newest = Instant::now();
        }
        let age = start.elapsed().as_secs_f64().into(); // a repeat ends no run that began meanwhile
        let words = [("verb", "stop"), ("id", &id), ("operator", "main.rs")];
        let mut fields = words.map(|(key, word)| (key.into(), word.into())).to_vec();
        fields.push(("age".into(), age));
        let query = session.get(format!("swarm/{swarm}/*/control/stop/anyone"));
        let query = query.payload(payload(Value::Map(fields))?);
        for reply in query.target(QueryTarget::All).timeout(Duration::from_secs(1)).wait()? {
            let Ok(sample) = reply.into_result() else { continue };
            let answer = read_value(&mut &sample.payload().to_bytes()[1..])?;
            let [robot, code] = ["robot", "code"].map(|key| answer[key].as_str().unwrap_or("?"));
            let is_at_rest = answer["is_moving"].as_bool() != Some(true);
            if is_at_rest && answered.insert(robot.to_string()) {
                println!("{robot} {code}");
            }
        }
        sleep(Duration::from_millis(100));
    }
    let missing: Vec<&String> = wanted.difference(&answered).collect();
    missing.iter().for_each(|name| println!("{name} has not answered that it stopped"));
    let is_done = !answered.is_empty() && missing.is_empty();
    is_done.then_some(()).ok_or(format!("not all robots of {swarm} answered").into())
}

fn main() -> Result<()> {
    let words: Vec<String> = env::args().skip(1).collect();
    let session = zenoh::open(Config::default()).wait()?;
    match words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [swarm, "list"] => list(&session, swarm),
        [swarm, "vote", program, opinion] => vote(&session, swarm, program, opinion.parse()?),
        [swarm, "stop", ref named @ ..] => stop(&session, swarm, named),
        _ => Err("expected: SWARM list, SWARM vote PROGRAM OPINION or SWARM stop ROBOT ...".into()),
    }
}
