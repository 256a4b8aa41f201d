//! A Zenoh router with the ros2dds plugin linked in. `ros2-router -c CONFIG.json5`
//!
//! The plugin is the one of zenoh-bridge-ros2dds, so that the routes, the keys and the liveliness
//! tokens are those of a bridge.

use zenoh::config::Config;
use zenoh::internal::{plugins::PluginsManager, runtime::RuntimeBuilder};
use zenoh_plugin_ros2dds::ROS2Plugin;

#[tokio::main]
async fn main() {
    zenoh::init_log_from_env_or("z=info");
    let arguments: Vec<String> = std::env::args().collect();
    let [_, option, path] = arguments.as_slice() else {
        fail("usage: ros2-router -c CONFIG.json5");
    };
    if option != "-c" {
        fail("usage: ros2-router -c CONFIG.json5");
    }
    let config = Config::from_file(path).unwrap_or_else(|error| fail(&format!("{path}: {error}")));
    let mut plugins = PluginsManager::static_plugins_only();
    plugins.declare_static_plugin::<ROS2Plugin, &str>("ros2dds", true);
    let building = RuntimeBuilder::new(config).plugins_manager(plugins).build();
    let mut runtime = building.await.unwrap_or_else(|error| fail(&error.to_string()));
    if let Err(error) = runtime.start().await {
        fail(&error.to_string());
    }
    std::future::pending::<()>().await;
}

fn fail(text: &str) -> ! {
    eprintln!("ros2-router: {text}");
    std::process::exit(1);
}
