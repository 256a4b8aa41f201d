//! A swarm by Zenoh: `cargo run -- meadow list`, `... vote teacher 2`, `... stop`
use rmpv::{decode::read_value, encode::write_value, Value};
use std::{collections::BTreeSet, env, thread::sleep, time::Duration, time::Instant};
use zenoh::{query::QueryTarget, Config, Result, Session, Wait};

fn payload(content: Value) -> Result<Vec<u8>> {
    let mut bytes = vec![1]; // the version of the format; MessagePack follows
    Ok(write_value(&mut bytes, &content).map(|()| bytes)?)
}

fn names(session: &Session, swarm: &str) -> Result<BTreeSet<String>> {
    let replies = session.liveliness().get(format!("swarm/{swarm}/*")).wait()?;
    let tokens = replies.into_iter().filter_map(|reply| reply.into_result().ok());
    Ok(tokens.filter_map(|token| token.key_expr().rsplit('/').next().map(String::from)).collect())
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

fn stop(session: &Session, swarm: &str) -> Result<()> {
    let id = session.zid().to_string(); // a new one for each request
    let (start, mut known, mut answered) = (Instant::now(), BTreeSet::new(), BTreeSet::new());
    // Scouting finds robots one by one: ask for 1 s, and for 5 s while a name lacks an answer.
    while start.elapsed().as_secs() < if known.is_empty() || known != answered { 5 } else { 1 } {
        known.append(&mut names(session, swarm)?);
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
    known.difference(&answered).for_each(|name| println!("{name} has not stopped"));
    (!answered.is_empty()).then_some(()).ok_or(format!("no robot of {swarm} answered").into())
}

fn main() -> Result<()> {
    let words: Vec<String> = env::args().skip(1).collect();
    let session = zenoh::open(Config::default()).wait()?;
    sleep(Duration::from_millis(200)); // robots answer the first scout
    match words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [swarm, "list"] => Ok(names(&session, swarm)?.iter().for_each(|name| println!("{name}"))),
        [swarm, "vote", program, opinion] => vote(&session, swarm, program, opinion.parse()?),
        [swarm, "stop"] => stop(&session, swarm),
        _ => Err("expected: SWARM list, SWARM vote PROGRAM OPINION or SWARM stop".into()),
    }
}
